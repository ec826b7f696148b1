// SPDX-License-Identifier: MIT
// A stream of another broker whose sender remembers poses: its followers get the sender's keys once they hold them.
#include <gtest/gtest.h>

#include "tests/unit/broker/backbone/sites.h"

namespace eigencast::broker::testing {
namespace {

/// Takes joins as a connection does: on a restart.
class JoiningViewer : public FakeReceiver {
 public:
  void on_stream_changed(const Stream& stream, bool restart) override {
    FakeReceiver::on_stream_changed(stream, restart);
    if (restart) take_join();
  }
  void on_restart(const Stream& stream) override {
    FakeReceiver::on_restart(stream);
    take_join();
  }
  void take_join() {
    if (watched == nullptr) return;
    if (const FramePtr join = watched->join_for(*this)) on_frame(join);
  }
  Stream* watched = nullptr;
};

class FollowedMemoryTest : public BackboneTest {
 protected:
  void SetUp() override {
    BackboneTest::SetUp();
    sender_ = &new_sender();
    publish(*sender_, a());
    watch(b(), viewer_);
    viewer_.watched = b().hub->find("s");
    pass(200'000);
    for (int i = 0; i < 3; ++i) plain_key();
  }
  void TearDown() override { sites.clear(); }  // Streams know their viewers to their end.
  Stream& here() { return *b().hub->find("s"); }
  void remember(int first, bool goes_on, bool stored = true) {
    auto segments = goes_on ? sender_->stream->memory()->segments : std::vector<Generation::Segment>();
    if (!goes_on && sender_->stream->memory()) {
      sender_->stream->set_memory(nullptr);
      sender_->forget_phase();
    }
    segments.push_back(segment_of(first, 20, asset.digest));
    if (stored) (void)a().put(*segments.back().coded);
    ASSERT_TRUE(a().hub->remember(*sender_->stream, std::move(segments)));
  }
  /// The viewer fetches what it was told of.
  void hold() {
    viewer_.memory = here().memory()->poses;
    here().note_held(viewer_, here().memory()->number);
  }
  void plain_key() {
    sender_->tag = sender_->stream->tag();
    add(sender_->next(capture += 33'000));
  }
  void recalled_key(std::uint32_t pose) {
    add(sender_->next_recalled(capture += 33'000, sender_->stream->memory()->poses, 8 * pose));
  }
  void add(const Bytes& message) {
    const auto added = sender_->stream->add_frame(message, now);
    ASSERT_TRUE(added) << added.error().message;
    sent_[sender_->stream->snapshot().newest->sequence] = sender_->sent();
    pass(33'000);
  }
  bool recalls() { return here().snapshot().newest->generation != 0; }
  /// What the broker that follows has is what was sent, or, of the other chain, near it.
  void check_newest() {
    const KeyRecord& newest = *here().snapshot().newest;
    const Key& key = newest.after->newer;
    const Key& sent = sent_.at(newest.sequence);
    for (std::size_t v = 0; v < sent.q.size(); ++v) ASSERT_NEAR(key.q[v], sent.q[v], recalls() ? 0 : 8) << v;
  }

  SiteSender* sender_ = nullptr;
  JoiningViewer viewer_;
  std::map<std::uint64_t, Key> sent_;
};

TEST_F(FollowedMemoryTest, FollowersChangeOverToTheSendersKeys) {
  remember(0, false);
  const std::uint64_t before = here().snapshot().newest->sequence;
  for (std::uint32_t pose = 1; pose < 19; ++pose) {
    recalled_key(pose);
    check_newest();
    EXPECT_EQ(here().snapshot().newest->sequence, before + pose) << "no frame waits for it";
  }
  EXPECT_TRUE(recalls());
  EXPECT_EQ(here().snapshot().newest->payload, sender_->stream->snapshot().newest->payload);
  EXPECT_EQ(here().memory()->poses.pose_count(), 20U);
  EXPECT_FALSE(viewer_.poses.back().envelope.is_recalled()) << "it lacks the memory";
  hold();
  recalled_key(3);
  EXPECT_TRUE(viewer_.poses.back().envelope.is_recalled());
  EXPECT_EQ(viewer_.poses.back().key, sender_->sent());
  const int joins = network.asked["test.joins.a"];
  for (std::uint32_t pose = 4; pose < 19; ++pose) recalled_key(pose);
  pass(3'000'000);
  EXPECT_EQ(network.asked["test.joins.a"], joins) << "all is settled";
}

TEST_F(FollowedMemoryTest, LossesAndOtherMemoriesShowNothingForeign) {
  int roots = 0;
  std::uint32_t recalled = 0;
  for (int i = 0; i < 600; ++i) {
    network.drops = [&](const std::string& subject) {
      return (i % 11 == 3 && subject == "test.frames.a.s.=") || (i % 13 == 5 && subject == "test.frames.a.s");
    };
    if (i % 100 == 3) remember(20 * ++roots, false);  // Nobody is told: the message is lost.
    if (i % 100 == 50) remember(500, true);
    if (sender_->stream->memory() && i % 3 != 0) {
      recalled_key(static_cast<std::uint32_t>(i % 100 > 50 ? 21 + i % 18 : i % 19));
    } else {
      plain_key();
    }
    check_newest();
    recalled += recalls() ? 1 : 0;
  }
  EXPECT_GT(recalled, 60U);
  network.drops = {};
  for (std::uint32_t pose = 0; pose < 38; ++pose) recalled_key(pose == 19 ? 18 : pose);
  check_newest();
  EXPECT_TRUE(recalls());
}

TEST_F(FollowedMemoryTest, WithoutItKeysNeedNone) {
  remember(0, false, false);
  for (std::uint32_t pose = 1; pose < 19; ++pose) {
    recalled_key(pose);
    check_newest();
  }
  EXPECT_FALSE(recalls());
  EXPECT_EQ(here().memory(), nullptr);
}

TEST_F(FollowedMemoryTest, MemoriesAreReadInTurnsOfTheirSenders) {
  b().reads_memories = false;
  remember(0, false);
  recalled_key(1);
  EXPECT_EQ(here().memory(), nullptr) << "it waits for its turn";
  ASSERT_EQ(b().reads.size(), 1U);
  const auto& [holder, read] = b().reads[0];
  EXPECT_EQ(holder, here().payer());
  EXPECT_FALSE(holder.empty());
  ASSERT_TRUE(read.wanted());
  read.load();
  EXPECT_EQ(here().memory(), nullptr);
  read.then();
  ASSERT_NE(here().memory(), nullptr);
  b().backbone->stop();
  EXPECT_FALSE(read.wanted());
  read.then();
}

TEST_F(FollowedMemoryTest, TheMemoryEndsWithItsEpoch) {
  remember(0, false);
  for (std::uint32_t pose = 1; pose < 19; ++pose) recalled_key(pose);
  sender_->announce(a(), asset);
  pass(200'000);
  sent_.clear();
  plain_key();
  plain_key();
  EXPECT_EQ(here().memory(), nullptr);
  check_newest();
  remember(20, false);
  for (std::uint32_t pose = 1; pose < 19; ++pose) recalled_key(pose);
  check_newest();
  EXPECT_TRUE(recalls());
}

TEST(MemoryMessageTest, MalformedOnesAreNotRead) {
  MemoryNotice notice{3, 4, 5, {Sha256{}, Sha256{}}};
  const Bytes bytes = bytes_from(notice);
  EXPECT_EQ(memory_message_from(bytes)->notice, notice);
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    const auto cut = memory_message_from(ByteView(bytes).first(size));
    EXPECT_EQ(cut.has_value(), size == 13 || size == 13 + 32) << size;
  }
  notice.segments.resize(257);
  EXPECT_FALSE(memory_message_from(bytes_from(notice)));
  Bytes other = bytes;
  other[0] = 'X';
  EXPECT_FALSE(memory_message_from(other));
}

}  // namespace
}  // namespace eigencast::broker::testing
