// SPDX-License-Identifier: MIT
// Ownership of streams among several brokers.
#include "tests/unit/broker/backbone/sites.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using State = control::StreamInfo::State;
using ClaimsTest = BackboneTest;

TEST_F(ClaimsTest, SecondSenderAtAnotherBrokerIsRefused) {
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  publish(first, a());
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  ASSERT_TRUE(second.granted.has_value());
  EXPECT_EQ(second.granted->error().code, ErrorCode::kRefused);
  EXPECT_EQ(b().backbone->totals().claims_refused, 1U);
  EXPECT_FALSE(first.replaced);
}

TEST_F(ClaimsTest, ReplacedSenderAtAnotherBrokerIsDismissed) {
  replaces = true;
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  publish(first, a());
  FakeReceiver& at_a = new_viewer();
  FakeReceiver& at_b = new_viewer();
  watch(a(), at_a);
  watch(b(), at_b);
  pass(100'000);
  send(first);
  publish(second, b());
  pass(200'000);
  EXPECT_TRUE(first.replaced);
  EXPECT_EQ(a().backbone->totals().senders_evicted, 1U);
  EXPECT_EQ(b().backbone->totals().claims_refused, 0U);
  send(second);
  for (const FakeReceiver* viewer : {&at_a, &at_b}) {
    EXPECT_EQ(viewer->infos.back().epoch, second.stream->epoch());
    EXPECT_EQ(viewer->infos.back().state, State::kLive);
    EXPECT_EQ(viewer->undecodable, 0);
    EXPECT_EQ(viewer->poses.back().key, key_number(1));
  }
}

TEST_F(ClaimsTest, ConcurrentClaimsAreResolved) {
  const Sha256 in_a = a().put(content(9, 10)), in_b = b().put(content(9, 10));
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  first.publish(a(), "s", in_a);
  second.publish(b(), "s", in_b);  // Neither knows of the other: both write.
  network.run();
  pass(500'000);
  ASSERT_TRUE(first.granted && second.granted);
  EXPECT_NE(first.granted->has_value(), second.granted->has_value());
  const Result<std::uint32_t>& loser = *first.granted ? *second.granted : *first.granted;
  EXPECT_EQ(loser.error().code, ErrorCode::kRefused);
}

TEST_F(ClaimsTest, SenderMovesBetweenBrokers) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  send(sender);
  const std::uint32_t epoch = viewer.infos.back().epoch;
  sender.leave();
  pass(100'000);
  EXPECT_EQ(viewer.infos.back().state, State::kStalled);
  // To the very broker where it was followed.
  SiteSender& moved = new_sender();
  publish(moved, b());
  ASSERT_TRUE(moved.claimed);
  pass(100'000);
  send(moved);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_GT(viewer.infos.back().epoch, epoch);
  EXPECT_EQ(viewer.undecodable, 0);
  // And back.
  FakeReceiver& other = new_viewer();
  watch(a(), other);
  pass(100'000);
  EXPECT_EQ(other.infos.back().state, State::kLive);
  moved.leave();
  pass(100'000);
  SiteSender& back = new_sender();
  publish(back, a());
  pass(100'000);
  send(back);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable + other.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().key, other.poses.back().key);
}

TEST_F(ClaimsTest, RefusedSenderDoesNotDisturbFollowedStream) {
  SiteSender& first = new_sender();
  publish(first, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  send(first);
  SiteSender& second = new_sender();
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  EXPECT_TRUE(second.claimed) << "the follower yields until the directory has spoken";
  EXPECT_FALSE(*second.granted);
  pass(200'000);
  send(first);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().envelope.sequence, 2U);
}

TEST_F(ClaimsTest, StreamOfDeadBrokerIsTakenOver) {
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  publish(first, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(6'000'000);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  a().link.cut();  // No word of goodbye.
  pass(1'000'000);
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  EXPECT_FALSE(*second.granted) << "too early";
  pass(Directory::kHeartbeatTimeoutUs);
  SiteSender& third = new_sender();
  publish(third, b());
  send(third);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(ClaimsTest, InventedEpochBlocksNoName) {
  for (const std::uint32_t invented : {UINT32_MAX, UINT32_MAX - 1, kMaxForeignEpoch + 1, kMaxForeignEpoch}) {
    const std::string name = std::to_string(invented);
    add_site("liar" + name);
    Site& liar = *sites.back();
    pass(1'000'000);
    const DirectoryEntry lie{"liar" + name, invented, true, small_announce()};
    liar.link.write_row(name, text_from_entry(lie), 0, [](const Result<std::uint64_t>&) {});
    network.run();
    liar.link.cut();
    pass(2 * Directory::kHeartbeatTimeoutUs);
    FakeReceiver& viewer = new_viewer();
    watch(a(), viewer, name);
    SiteSender& sender = new_sender();
    publish(sender, b(), name);
    pass(1'000'000);
    EXPECT_LT(sender.stream->epoch(), 1000u) << invented;
    EXPECT_EQ(viewer.infos.back().state, State::kLive) << "others see it";
  }
}

std::string proof(int number) {
  return number == 0 ? std::string() : "proof of secret " + std::to_string(number);
}

/// With the proofs of secrets 1, 2, ... of one after the other.
class ResumeClaimsTest : public ClaimsTest {
 protected:
  /// The secret `shown` (0: none) in return for secret `issued`.
  SiteSender& announce(Site& site, int shown, int issued) {
    SiteSender& sender = new_sender();
    sender.publish(site, "s", site.put(content(9, 10)), {proof(shown), proof(issued)});
    network.run();
    return sender;
  }
};

TEST_F(ResumeClaimsTest, LivingSenderDoesNotWaitForTheLease) {
  add_site("c");
  pass(6'000'000);
  SiteSender& first = announce(a(), 0, 1);
  ASSERT_TRUE(*first.granted);
  FakeReceiver& at_b = new_viewer();
  FakeReceiver& at_c = new_viewer();
  watch(b(), at_b);
  watch(*sites[2], at_c);
  pass(100'000);
  send(first);
  ASSERT_EQ(at_c.infos.back().epoch, **first.granted);
  a().link.cut();
  SiteSender& second = announce(b(), 1, 2);
  ASSERT_TRUE(second.granted.has_value());
  ASSERT_TRUE(*second.granted) << second.granted->error().message;
  EXPECT_GT(**second.granted, **first.granted);
  pass(100'000);
  send(second);
  for (const FakeReceiver* viewer : {&at_b, &at_c}) {
    EXPECT_EQ(viewer->infos.back().epoch, **second.granted);
    EXPECT_EQ(viewer->infos.back().state, State::kLive);
    EXPECT_EQ(viewer->undecodable, 0);
  }
  EXPECT_EQ(at_b.poses.back().key, at_c.poses.back().key);
}

TEST_F(ResumeClaimsTest, ItsOwnPastAtALivingBrokerIsDismissed) {
  SiteSender& first = announce(a(), 0, 1);
  SiteSender& second = announce(b(), 1, 2);
  ASSERT_TRUE(*second.granted);
  pass(100'000);
  EXPECT_TRUE(first.replaced);
  SiteSender& third = announce(a(), 2, 3);
  ASSERT_TRUE(*third.granted) << "and back";
  EXPECT_GT(**third.granted, **second.granted);
}

TEST_F(ResumeClaimsTest, OtherSecretsWaitForTheLease) {
  ASSERT_TRUE(*announce(a(), 0, 1).granted);
  ASSERT_TRUE(*announce(b(), 1, 2).granted);
  pass(6'000'000);
  b().link.cut();
  for (const int shown : {0, 1, 3}) {
    const SiteSender& thief = announce(a(), shown, 4);
    ASSERT_TRUE(thief.granted.has_value());
    ASSERT_FALSE(*thief.granted) << "none, of an older epoch, wrong";
    EXPECT_EQ(thief.granted->error().code, ErrorCode::kRefused);
  }
  pass(Directory::kHeartbeatTimeoutUs + 100'000);
  EXPECT_TRUE(*announce(a(), 0, 4).granted);
}

TEST_F(ResumeClaimsTest, ProofSurvivesALostDirectory) {
  SiteSender& first = announce(a(), 0, 1);
  ASSERT_TRUE(*first.granted);
  network.lose_table();
  for (const auto& site : sites) site->link.cut();
  pass(100'000);
  for (const auto& site : sites) site->link.connect();
  pass(1'000'000);
  EXPECT_FALSE(*announce(b(), 2, 3).granted);
  EXPECT_TRUE(*announce(b(), 1, 3).granted);
}

/// Several announcements while the answer of the directory to the first is on its way.
class RoundTripTest : public ResumeClaimsTest {
 protected:
  void SetUp() override {
    ResumeClaimsTest::SetUp();
    network.holds_answers = true;
  }
  void answer() {
    network.holds_answers = false;
    for (const auto& work : std::exchange(network.held, {})) work();
    pass(1'000'000);
  }
  /// The directory has what `sender` announced last, and the stream goes on with it at both brokers.
  void expect_announced(const SiteSender& sender, const Sha256& of, const std::string& issued) {
    ASSERT_TRUE(sender.granted && *sender.granted);
    const auto row = entry_from_text(network.table.at("s").text.value());
    ASSERT_TRUE(row) << row.error().message;
    EXPECT_EQ(row->epoch, sender.stream->epoch());
    EXPECT_EQ(row->epoch, **sender.granted);
    EXPECT_EQ(row->announce.asset, of.hex());
    EXPECT_EQ(row->resume, issued);
    EXPECT_TRUE(row->live);
    FakeReceiver& viewer = new_viewer();
    watch(b(), viewer);
    pass(100'000);
    EXPECT_EQ(viewer.infos.back().asset, of.hex());
    EXPECT_EQ(viewer.infos.back().epoch, row->epoch);
  }
};

TEST_F(RoundTripTest, LastAnnouncementIsInTheDirectory) {
  const Sha256 one = a().put(content(1, 10)), two = a().put(content(2, 10)), three = a().put(content(3, 10));
  SiteSender& sender = new_sender();
  sender.publish(a(), "s", one, {"", proof(1)});
  network.run();
  sender.announce(a(), two, {"", proof(2)});
  sender.announce(a(), three, {"", proof(3)});
  network.run();
  answer();
  expect_announced(sender, three, proof(3));
  const int writes = network.writes;
  pass(1'000'000);
  EXPECT_EQ(network.writes, writes) << "the directory is as it should be";
  EXPECT_FALSE(*announce(b(), 1, 4).granted);
  EXPECT_TRUE(*announce(b(), 3, 4).granted);
}

TEST_F(RoundTripTest, AnnouncementOfALiveStreamIsInTheDirectory) {
  network.holds_answers = false;
  const Sha256 one = a().put(content(1, 10)), two = a().put(content(2, 10)), three = a().put(content(3, 10));
  SiteSender& sender = new_sender();
  sender.publish(a(), "s", one, {"", proof(1)});
  pass(100'000);
  network.holds_answers = true;
  sender.announce(a(), two, {"", proof(2)});
  network.run();
  sender.announce(a(), three, {"", proof(3)});
  pass(100'000);
  answer();
  expect_announced(sender, three, proof(3));
}

TEST_F(RoundTripTest, TakeoverIsInTheDirectory) {
  const Sha256 one = a().put(content(1, 10)), two = a().put(content(2, 10));
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  first.publish(a(), "s", one, {"", proof(1)});
  network.run();
  second.publish(a(), "s", two, {"", proof(2)}, true);
  EXPECT_TRUE(first.replaced);
  network.run();
  answer();
  expect_announced(second, two, proof(2));
}

TEST_F(RoundTripTest, LateAnswerGrantsNoLaterAnnouncement) {
  const Sha256 one = a().put(content(1, 10)), two = a().put(content(2, 10));
  SiteSender& sender = new_sender();
  sender.publish(a(), "s", one, {"", proof(1)});
  network.run();
  a().link.cut();
  pass(100'000);
  ASSERT_TRUE(sender.granted && *sender.granted) << "locally";
  a().link.connect();
  network.run();
  sender.announce(a(), two, {"", proof(2)});
  network.run();
  answer();
  expect_announced(sender, two, proof(2));
}

TEST_F(RoundTripTest, OneWriteAtATimeOfEachRow) {
  SiteSender& sender = new_sender();
  sender.publish(a(), "s", a().put(content(1, 10)));
  network.run();
  for (int i = 0; i < 10; ++i) {
    a().link.connect();
    pass(100'000);
  }
  EXPECT_EQ(network.writes, 1);
}

TEST_F(ClaimsTest, EpochsGrowAcrossForgottenRows) {
  add_site("c");
  for (int i = 0; i < 20; ++i) {  // The epochs of a are ahead.
    SiteSender& sender = new_sender();
    publish(sender, a(), "other");
    sender.leave();
  }
  SiteSender& first = new_sender();
  publish(first, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  const std::uint32_t epoch = viewer.infos.back().epoch;
  first.leave();
  for (int i = 0; i < 12; ++i) pass(60'000'000);
  ASSERT_FALSE(network.table.contains("s"));
  SiteSender& second = new_sender();
  second.publish(*sites[2], "s", sites[2]->put(content(9, 10)));  // Where nobody watches.
  pass(1'000'000);
  ASSERT_TRUE(second.granted && *second.granted);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_GT(viewer.infos.back().epoch, epoch);
}

TEST_F(ClaimsTest, AnEpochThatWasPromisedIsGivenToNobodyElse) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  pass(100'000);
  const Sha256 other = a().put(content(7, 10));
  sender.stream->prepare(std::make_shared<const control::StreamInfo::Next>(control::StreamInfo::Next{other.hex(), 1}));
  pass(500'000);
  const auto promised = a().backbone->next_epoch("s");
  ASSERT_TRUE(promised);
  a().link.cut();  // It dies before the first frame of that epoch.
  pass(10'000'000);
  SiteSender& moved = new_sender();
  publish(moved, b());
  pass(500'000);
  ASSERT_TRUE(moved.granted && *moved.granted);
  EXPECT_GT(moved.granted->value(), *promised);
}

TEST_F(ClaimsTest, OneSenderStaysAfterPartition) {
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  publish(first, a());
  a().link.cut();
  pass(7'000'000);
  publish(second, b());
  FakeReceiver& at_a = new_viewer();
  FakeReceiver& at_b = new_viewer();
  watch(a(), at_a);
  watch(b(), at_b);
  send(first);
  send(second);
  ASSERT_NE(at_a.infos.back().epoch, at_b.infos.back().epoch);
  a().link.connect();
  pass(1'000'000);
  EXPECT_NE(first.replaced, second.replaced);
  EXPECT_TRUE(first.replaced) << "the later one stays";
  pass(100'000);
  send(second);
  EXPECT_EQ(at_a.infos.back().epoch, at_b.infos.back().epoch);
  EXPECT_EQ(at_a.poses.back().key, at_b.poses.back().key);
  EXPECT_EQ(at_a.undecodable + at_b.undecodable, 0);
}

TEST_F(ClaimsTest, BrokersWithoutTheDirectoryGrantDifferentEpochs) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  pass(1'000'000);
  sender.leave();
  pass(1'000'000);
  a().link.cut();
  b().link.cut();
  pass(1'000'000);
  SiteSender& at_a = new_sender();
  SiteSender& at_b = new_sender();
  at_a.publish(a(), "s", asset);
  at_b.publish(b(), "s", asset);
  network.run();
  EXPECT_GT(**at_a.granted, 1U);
  EXPECT_GT(**at_b.granted, 1U);
  EXPECT_NE(**at_a.granted, **at_b.granted);
}

TEST_F(ClaimsTest, StoppedBrokerReleasesItsStreams) {
  SiteSender& first = new_sender();
  publish(first, a());
  a().backbone->stop();
  network.run();
  SiteSender& second = new_sender();
  publish(second, b());
}

}  // namespace
}  // namespace eigencast::broker
