// SPDX-License-Identifier: MIT
#include "broker/operation/logger.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace eigencast::broker {
namespace {

using ::testing::ElementsAre;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

std::vector<std::string> texts(const std::vector<LogQueue::Line>& lines) {
  std::vector<std::string> out;
  for (const auto& line : lines) out.push_back(line.text);
  return out;
}

std::vector<std::string> taken(LogQueue& queue, TimeUs now_us, bool ends = false) {
  return texts(queue.take(now_us, ends));
}

/// One place of the source.
void push_one_kind(LogQueue& queue, const std::string& text, TimeUs now_us) {
  queue.push(LogLevel::kWarning, text, now_us);
}

TEST(LogLineTest, KnowsWhereItWasLogged) {
  std::vector<std::pair<std::string, int>> places;
  const LogSink sink = [&](LogLevel, const LogLine& line) { places.emplace_back(line.file, line.number); };
  for (int i = 0; i < 2; ++i) log(sink, LogLevel::kInfo, "one " + std::to_string(i));
  log(sink, LogLevel::kInfo, "two");
  ASSERT_EQ(places.size(), 3u);
  EXPECT_THAT(places[0].first, EndsWith("logger_test.cpp"));
  EXPECT_EQ(places[0], places[1]);
  EXPECT_NE(places[1], places[2]);
}

TEST(LogQueueTest, FloodOfOneKindIsCounted) {
  LogQueue queue({2, 1 << 20, 1000});
  push_one_kind(queue, "aaaa", 0);
  push_one_kind(queue, "bbbb", 1);
  EXPECT_TRUE(queue.has_lines());
  EXPECT_THAT(taken(queue, 1), ElementsAre("aaaa", "bbbb"));
  for (int i = 2; i < 900; ++i) push_one_kind(queue, std::string(50, static_cast<char>('a' + i % 26)), i);
  push_one_kind(queue, "zzzz", 900);
  EXPECT_FALSE(queue.has_lines());
  queue.push(LogLevel::kError, "of another kind", 901);
  EXPECT_THAT(taken(queue, 901), ElementsAre("of another kind"));
  EXPECT_THAT(taken(queue, 999), ElementsAre());
  const auto counted = queue.take(1000);
  ASSERT_THAT(texts(counted), ElementsAre("899 more lines like this: zzzz"));
  EXPECT_EQ(counted.front().level, LogLevel::kWarning);
  push_one_kind(queue, "dddd", 1000);
  EXPECT_THAT(taken(queue, 1000), ElementsAre("dddd")) << "a new period";
}

TEST(LogQueueTest, LinesBeyondTheBoundAreDroppedAndCounted) {
  LogQueue queue({1000, 4096, 1000});
  const std::string line(1000, 'x');
  for (int i = 0; i < 10; ++i) push_one_kind(queue, line, i);
  const auto lines = taken(queue, 10);
  ASSERT_EQ(lines.size(), 4u) << "3 lines of 1000 bytes and more";
  EXPECT_THAT(lines.back(), StartsWith("7 lines are missing here"));
  push_one_kind(queue, std::string(1 << 20, 'x'), 11);
  EXPECT_EQ(taken(queue, 11).at(0).size(), 1024u) << "what a peer makes long is cut";
}

TEST(LogQueueTest, CountsAreWrittenAtTheEnd) {
  LogQueue queue({1, 1 << 20, 1000});
  push_one_kind(queue, "a", 0);
  push_one_kind(queue, "b", 1);
  EXPECT_THAT(taken(queue, 2, true), ElementsAre("a", "1 more lines like this: b"));
  EXPECT_THAT(taken(queue, 2, true), ElementsAre());
}

TEST(LoggerTest, EverythingIsWrittenEscapedBeforeTheSinkEnds) {
  for (const char* format : {"text", "json"}) {
    Config config;
    config.log.format = format;
    config.log.max_lines = 3;
    ::testing::internal::CaptureStderr();
    {
      const LogSink sink = make_log_sink(config);
      for (int i = 0; i < 5; ++i) log(sink, LogLevel::kInfo, "says \x1b]0;\u009b\x7f\n " + std::to_string(i));
      log(sink, LogLevel::kDebug, "below the level");
    }
    const std::string written = ::testing::internal::GetCapturedStderr();
    EXPECT_EQ(std::count(written.begin(), written.end(), '\n'), 4) << written;
    EXPECT_THAT(written, HasSubstr("says \\u001b]0;\\u009b\\u007f\\"));
    EXPECT_THAT(written, HasSubstr("2 more lines like this: says "));
    EXPECT_THAT(written, Not(HasSubstr("\x1b")));
    EXPECT_THAT(written, Not(HasSubstr("below")));
  }
}

}  // namespace
}  // namespace eigencast::broker
