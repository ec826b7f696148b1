// SPDX-License-Identifier: MIT
#include "broker/backbone/directory.h"

#include <gtest/gtest.h>

#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

DirectoryEntry entry_of(const std::string& owner, std::uint32_t epoch, bool live = true) {
  return {owner, epoch, live, testing::small_announce()};
}

TEST(Directory, EntriesRoundTrip) {
  DirectoryEntry entry = entry_of("0123456789abcdef", 4'000'000'000U);
  const auto read = entry_from_text(text_from_entry(entry));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->owner, entry.owner);
  EXPECT_EQ(read->epoch, entry.epoch);
  EXPECT_EQ(read->announce.asset, entry.announce.asset);
  EXPECT_EQ(read->announce.format, entry.announce.format);
  EXPECT_EQ(read->resume, "") << "as older brokers write it";
  entry.resume = std::string(64, '7');
  entry.announce.resume = "secret";
  const auto again = entry_from_text(text_from_entry(entry));
  ASSERT_TRUE(again) << again.error().message;
  EXPECT_EQ(again->resume, entry.resume);
  EXPECT_EQ(again->announce.resume, "");
}

TEST(Directory, TruncatedEntriesAreRefused) {
  const std::string text = text_from_entry(entry_of("a", 1));
  for (std::size_t n = 0; n < text.size(); ++n) EXPECT_FALSE(entry_from_text(text.substr(0, n))) << n;
}

TEST(Directory, HostileEntriesAreRefused) {
  const std::string good = text_from_entry(entry_of("a", 1));
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return text.replace(at, from.size(), to);
  };
  EXPECT_TRUE(entry_from_text(good));
  EXPECT_FALSE(entry_from_text(with("\"epoch\":1", "\"epoch\":0")));
  EXPECT_FALSE(entry_from_text(with("\"epoch\":1", "\"epoch\":4294967295")));
  EXPECT_FALSE(entry_from_text(with("\"epoch\":1", "\"epoch\":-1")));
  EXPECT_FALSE(entry_from_text(with("\"live\":true", "\"live\":1")));
  EXPECT_FALSE(entry_from_text(with("\"owner\":\"a\"", "\"owner\":\"\"")));
  EXPECT_FALSE(entry_from_text(with("\"owner\":\"a\"", "\"owner\":\"" + std::string(65, 'x') + "\"")));
  for (const char* owner : {"*", "a.>", "a b", ".a", "a.", "a..b", "a\\r\\nPUB x 0\\r\\n"}) {
    EXPECT_FALSE(entry_from_text(with("\"owner\":\"a\"", std::string("\"owner\":\"") + owner + "\"")))
        << "it is a part of subjects: " << owner;
  }
  EXPECT_FALSE(entry_from_text(with("quantised", "quantized")));
  EXPECT_FALSE(entry_from_text(with("\"live\":", "\"resume\":1,\"live\":")));
  EXPECT_FALSE(entry_from_text(with("\"live\":", "\"resume\":\"\",\"live\":")));
  EXPECT_FALSE(entry_from_text(std::string(100'000, ' ')));
}

TEST(Directory, TokensAndNamesAreOneToOne) {
  EXPECT_EQ(token_from_stream("lab/arm-2/v1.5"), "lab.arm-2.v1=5");
  for (const char* name : {"demo", "lab/arm", "a.b/c..d/-_", "x"}) {
    EXPECT_EQ(stream_from_token(token_from_stream(name)), name);
  }
  for (const char* token : {"", "a..b", ".a", "a/b", "a b", "*", ">", "=" /* the name "." */}) {
    EXPECT_EQ(stream_from_token(token), std::nullopt) << token;
  }
}

TEST(Directory, OlderRevisionsAreIgnored) {
  Directory directory("me", 0);
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("a", 7)), 10, 0));
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("b", 6)), 9, 0));
  EXPECT_EQ(directory.find("s")->entry->owner, "a");
  ASSERT_TRUE(directory.take("s", std::nullopt, 11, 0));
  EXPECT_EQ(directory.find("s")->entry, std::nullopt);
  EXPECT_EQ(directory.revision("s"), 11U) << "the next change must name the removal";
  EXPECT_EQ(directory.revision("other"), 0U);
}

TEST(Directory, SilentBrokersOwnNothing) {
  Directory directory("me", 0);
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("a", 7)), 1, 0));
  EXPECT_NE(directory.live("s", Directory::kHeartbeatTimeoutUs - 1), nullptr) << "too early to know";
  EXPECT_EQ(directory.live("s", Directory::kHeartbeatTimeoutUs), nullptr);
  directory.note_heartbeat("a", Directory::kHeartbeatTimeoutUs);
  EXPECT_NE(directory.live("s", 2 * Directory::kHeartbeatTimeoutUs - 1), nullptr);
  EXPECT_EQ(directory.live("s", 2 * Directory::kHeartbeatTimeoutUs), nullptr);
  directory.note_heartbeat("a", 2 * Directory::kHeartbeatTimeoutUs);
  directory.note_stopped("a");
  EXPECT_EQ(directory.live("s", 2 * Directory::kHeartbeatTimeoutUs), nullptr) << "it said so";
}

TEST(Directory, IdleBrokersSendFewerHeartbeatsInCrowds) {
  Directory directory("me", 0);
  EXPECT_EQ(directory.heartbeat_periods(), 1);
  const TimeUs now = Directory::kHeartbeatTimeoutUs;
  for (int i = 0; i < 1000; ++i) directory.note_heartbeat("broker-" + std::to_string(i), now);
  EXPECT_EQ(directory.heartbeat_periods(), 10);
  EXPECT_EQ(directory.brokers(now + 10 * Directory::kHeartbeatTimeoutUs - 1), 1001U) << "silent, and counted yet";
  EXPECT_FALSE(directory.is_alive("broker-1", now + Directory::kHeartbeatTimeoutUs))
      << "brokers with a stream send every heartbeat";
  EXPECT_EQ(directory.brokers(now + 10 * Directory::kHeartbeatTimeoutUs), 1U);
  directory.forget_silent(now + 2 * Directory::kForgetUs + 1);
  EXPECT_EQ(directory.heartbeat_periods(), 1);
}

TEST(Directory, ForgetsEntriesOfGoneBrokers) {
  Directory directory("me", 0);
  ASSERT_TRUE(directory.take("theirs", text_from_entry(entry_of("a", 1)), 1, 0));
  ASSERT_TRUE(directory.take("mine", text_from_entry(entry_of("me", 1)), 2, 0));
  EXPECT_TRUE(directory.forgotten(Directory::kForgetUs - 1).empty());
  EXPECT_EQ(directory.forgotten(Directory::kForgetUs), std::vector<std::string>{"theirs"});
}

TEST(Directory, ForgetsManyEntriesAFewAtATime) {
  Directory directory("me", 0);
  std::uint64_t revision = 0;
  for (int i = 0; i < 1'000; ++i)
    ASSERT_TRUE(directory.take("x" + std::to_string(i), text_from_entry(entry_of("gone", 1)), ++revision, 0));
  int passes = 0;
  for (std::vector<std::string> names; !(names = directory.forgotten(Directory::kForgetUs)).empty(); ++passes) {
    EXPECT_LE(names.size(), 50U);
    for (const std::string& name : names)
      ASSERT_TRUE(directory.take(name, std::nullopt, ++revision, Directory::kForgetUs, "me"));
  }
  EXPECT_GE(passes, 20);
}

TEST(Directory, ForgetsStreamsThatEndedHere) {
  Directory directory("me", 0);
  ASSERT_TRUE(directory.take("ended", text_from_entry(entry_of("me", 1, false)), 1, Directory::kForgetUs));
  EXPECT_TRUE(directory.forgotten(2 * Directory::kForgetUs).empty());
  EXPECT_EQ(directory.forgotten(2 * Directory::kForgetUs + 1), std::vector<std::string>{"ended"});
}

TEST(Directory, BrokersSpeakForThemselves) {
  Directory directory("me", 0);
  const TimeUs now = 2 * Directory::kHeartbeatTimeoutUs;
  directory.note_heartbeat("a", now);
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("a", 1)), 1, now));
  const auto forged = directory.take("s", text_from_entry(entry_of("a", 2)), 2, now, "evil");
  ASSERT_FALSE(forged);
  EXPECT_EQ(forged.error().code, ErrorCode::kRefused);
  EXPECT_EQ(directory.take("s", std::nullopt, 2, now, "evil").error().code, ErrorCode::kRefused);
  EXPECT_EQ(directory.take("t", text_from_entry(entry_of("a", 1)), 2, now, "evil").error().code, ErrorCode::kRefused);
  EXPECT_EQ(directory.find("s")->entry->epoch, 1U);
  EXPECT_EQ(directory.find("t"), nullptr);
  EXPECT_TRUE(directory.take("s", text_from_entry(entry_of("a", 2)), 2, now, "a"));
  EXPECT_TRUE(directory.take("s", text_from_entry(entry_of("b", 3)), 3, now, "b")) << "a sender moves";
  EXPECT_TRUE(directory.take("s", std::nullopt, 4, now, "c")) << "b is gone: any broker may tidy up";
  EXPECT_EQ(directory.find("s")->entry, std::nullopt);
}

TEST(Directory, TheTableHasTheLastWord) {
  Directory directory("me", 0);
  constexpr std::uint64_t kNever = UINT64_MAX;
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("a", 1)), 7, 0));
  directory.end_reading();
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("evil", 9)), kNever, 0, "evil"));
  ASSERT_TRUE(directory.take("t", text_from_entry(entry_of("evil", 9)), kNever, 0, "evil"));
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("a", 1)), 7, 0));
  EXPECT_EQ(directory.find("s")->entry->owner, "evil") << "it may be the newer one";
  directory.end_reading();
  ASSERT_TRUE(directory.take("s", text_from_entry(entry_of("a", 1)), 7, 0));
  EXPECT_EQ(directory.find("s")->entry->owner, "a");
  directory.end_reading();
  EXPECT_EQ(directory.revision("s"), 7U);
  EXPECT_EQ(directory.find("t"), nullptr);
}

TEST(Directory, InventedStreamsLeaveRoomForTrueOnes) {
  Directory directory("me", 0);
  const TimeUs now = 2 * Directory::kHeartbeatTimeoutUs;
  for (const char* broker : {"evil.1", "evil.2", "a.1"}) directory.note_heartbeat(broker, now);
  std::size_t taken = 0;
  std::uint64_t revision = 0;
  const auto invent = [&](const std::string& owner) {
    const std::string name = "x" + std::to_string(++revision);
    taken += directory.take(name, text_from_entry(entry_of(owner, 1)), revision, now) ? 1 : 0;
  };
  for (std::size_t i = 0; i < Directory::kMaxStreamsPerName + 1000; ++i) invent(i % 2 == 0 ? "evil.1" : "evil.2");
  EXPECT_EQ(taken, Directory::kMaxStreamsPerName) << "of one name, whatever its runs";
  for (std::size_t i = 0; i < Directory::kMaxStreams; ++i) invent("gone-" + std::to_string(i % 1000));
  EXPECT_EQ(directory.streams().size(), Directory::kMaxStreams);
  EXPECT_TRUE(directory.take("true", text_from_entry(entry_of("a.1", 1)), ++revision, now + 1'000'000));
  EXPECT_NE(directory.live("true", now), nullptr);
  EXPECT_LE(directory.streams().size(), Directory::kMaxStreamsPerName + 1) << "of gone brokers";
  EXPECT_TRUE(directory.take("mine", text_from_entry(entry_of("me", 1)), ++revision, now));
}

TEST(Directory, EndedStreamsMakeRoomForOthersOfTheirBroker) {
  Directory directory("me", 0);
  const TimeUs now = 2 * Directory::kHeartbeatTimeoutUs;
  directory.note_heartbeat("a.1", now);
  std::uint64_t revision = 0;
  const auto take = [&](const std::string& name, bool live) {
    return directory.take(name, text_from_entry(entry_of("a.1", 1, live)), ++revision, now).has_value();
  };
  ASSERT_TRUE(take("live", true));
  for (std::size_t i = 1; i < Directory::kMaxStreamsPerName; ++i)
    ASSERT_TRUE(take("ended/" + std::to_string(i), false));
  EXPECT_TRUE(take("new", true));
  EXPECT_NE(directory.live("new", now), nullptr);
  EXPECT_NE(directory.live("live", now), nullptr);
  EXPECT_EQ(directory.revision("ended/7"), 8U) << "who claims it needs to know";
}

TEST(Directory, RunsOfANameAreBounded) {
  Directory directory("me", 0);
  const TimeUs now = 2 * Directory::kHeartbeatTimeoutUs;
  directory.note_heartbeat("evil-2.1", now);
  directory.note_heartbeat("evi.1", now);
  for (int i = 0; i < 1000; ++i) directory.note_heartbeat("evil." + std::to_string(i), now + i);
  EXPECT_EQ(directory.brokers(now + 1000), 3 + Directory::kMaxRuns);
  EXPECT_TRUE(directory.is_alive("evil.0", now + 1000)) << "invented runs end none that lives";
  EXPECT_FALSE(directory.is_alive("evil.999", now + 1000));
  const TimeUs later = now + Directory::kHeartbeatTimeoutUs;
  directory.note_heartbeat("evil.999", later);
  EXPECT_TRUE(directory.is_alive("evil.999", later)) << "a silent one makes room";
  EXPECT_TRUE(directory.is_alive("evil.1", later));
  EXPECT_TRUE(directory.is_alive("evil-2.1", now + 1000));
  directory.note_heartbeat("a b", now);
  directory.note_heartbeat("*", now);
  EXPECT_EQ(directory.brokers(now + 1000), 3 + Directory::kMaxRuns);
}

TEST(Directory, ExactlyOneOfTwoSendersYields) {
  for (std::uint32_t e : {1U, 2U, 3U}) {
    for (const char* owner : {"a", "c"}) {
      const DirectoryEntry mine = entry_of("b", 2), other = entry_of(owner, e);
      EXPECT_NE(yields_to(mine, other), yields_to(other, mine));
    }
  }
}

}  // namespace
}  // namespace eigencast::broker
