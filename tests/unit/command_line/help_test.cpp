// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>

#include "common/command_line/command_line.h"

namespace eigencast {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(Help, LimitsAreWords) {
  double part = 1, rate = 30, seconds = 0;
  int count = 3;
  std::string kind = "b";
  bool again = false;
  CommandLine line("mover", "Moves things.", "1");
  const std::vector<OptionEntry> entries{
      {"--part", &part, "how much", OptionEntry::Range{0, 1}},
      {"--rate", &rate, "a second", OptionEntry::Range{0.5, 1e7}, true},
      {"--seconds", &seconds, "how long", OptionEntry::Range{0, 1e7}},
      {"--count", &count, "how many", OptionEntry::Range{2, 15}, false, "MOVER_COUNT"},
      {"--kind", &kind, "which", std::vector<std::string>{"a", "b"}, true}};
  line.add(entries, "Motion");
  const std::vector<OptionEntry> flags{{"--again", &again, "once more"}};
  line.add(flags, "End");
  const std::string help = line.app().help();
  EXPECT_THAT(help, Not(HasSubstr("FLOAT")));
  EXPECT_THAT(help, Not(HasSubstr("INT")));
  EXPECT_THAT(help, Not(HasSubstr("1e+07"))) << "a limit that nobody reaches";
  EXPECT_THAT(help, AllOf(HasSubstr("0 to 1"), HasSubstr("at least 0.5"), HasSubstr("2 to 15"), HasSubstr("a, b")));
  EXPECT_THAT(help, AllOf(HasSubstr("default: 30"), HasSubstr("MOVER_COUNT")));
  EXPECT_LT(help.find("Motion:"), help.find("--part"));
  EXPECT_LT(help.find("--kind"), help.find("End:"));
}

TEST(Help, RefusalsAreWords) {
  double part = 1, rate = 30, wait = 1;
  int count = 3;
  std::uint64_t frames = 0;
  std::string kind = "b", name;
  CommandLine line("mover", "Moves things.", "1");
  const std::vector<OptionEntry> entries{{"--part", &part, "how much", OptionEntry::Range{0, 1}},
                                         {"--rate", &rate, "a second", OptionEntry::Range{0.5, 1e7}},
                                         {"--wait", &wait, "seconds", OptionEntry::Range{0, 1e7}},
                                         {"--count", &count, "how many", OptionEntry::Range{2, 15}},
                                         {"--frames", &frames, "how many"},
                                         {"--kind", &kind, "which", std::vector<std::string>{"a", "b"}},
                                         {"--name", &name, "whose"}};
  line.add(entries, "Motion");
  const auto refusal = [&](std::vector<const char*> words) {
    words.insert(words.begin(), "mover");
    ::testing::internal::CaptureStderr();
    EXPECT_EQ(line.parse(static_cast<int>(words.size()), words.data()), false);
    return ::testing::internal::GetCapturedStderr();
  };
  const std::string how = "\nTry mover --help\n", who = "mover: ";
  EXPECT_EQ(refusal({"--part", "7"}), who + "--part: 7 is not 0 to 1" + how);
  EXPECT_EQ(refusal({"--part", "half"}), who + "--part: half is not 0 to 1" + how);
  EXPECT_EQ(refusal({"--rate", "0"}), who + "--rate: 0 is not at least 0.5" + how);
  EXPECT_EQ(refusal({"--wait", "-1"}), who + "--wait: -1 is not at least 0" + how);
  EXPECT_EQ(refusal({"--frames", "-1"}), who + "--frames: -1 is not at least 0" + how);
  EXPECT_EQ(refusal({"--count", "1"}), who + "--count: 1 is not 2 to 15" + how);
  EXPECT_EQ(refusal({"--kind", "c"}), who + "--kind: c is none of a, b" + how);
  EXPECT_EQ(refusal({"--count"}), who + "--count: a number is missing" + how);
  EXPECT_EQ(refusal({"--name"}), who + "--name: a word is missing" + how);
  EXPECT_EQ(refusal({"--flies"}), who + "--flies was not expected" + how);
}

}  // namespace
}  // namespace eigencast
