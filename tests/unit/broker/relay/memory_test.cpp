// SPDX-License-Identifier: MIT
// A stream whose sender remembers poses: who holds them gets its bytes, who does not keys that need none.
#include <gtest/gtest.h>

#include <algorithm>

#include "broker/relay/hub.h"
#include "broker/relay/outbox.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using testing::FakeReceiver;
using testing::FakeSender;
using testing::key_number;
using testing::kLinear;
using testing::kRaw;
using testing::segment_of;
using testing::small_announce;
using testing::small_layout;

/// Takes joins as a connection does: on a restart.
class MemoryViewer : public FakeReceiver {
 public:
  using FakeReceiver::FakeReceiver;
  void on_stream_changed(const Stream& stream, bool restart) override {
    FakeReceiver::on_stream_changed(stream, restart);
    if (restart) take_join();
  }
  void on_restart(const Stream& stream) override {
    FakeReceiver::on_restart(stream);
    ++restarts;
    take_join();
  }
  void on_memory(const Stream& stream) override { told.push_back(stream.memory()->number); }
  void take_join() {
    if (watched == nullptr) return;
    if (const FramePtr join = watched->join_for(*this)) on_frame(join);
  }
  /// How many of the frames need a memory.
  int recalled() const {
    return static_cast<int>(std::count_if(frames.begin(), frames.end(),
                                          [](const FramePtr& frame) { return frame->envelope.is_recalled(); }));
  }
  Stream* watched = nullptr;
  int restarts = 0;
  std::vector<std::uint32_t> told;
};

class MemoryTest : public ::testing::Test {
 protected:
  MemoryTest() {
    Hub::Settings settings;
    settings.stream.max_memory_bytes = 40'000;
    hub_ = std::make_unique<Hub>(settings);
    stream_ = hub_->open("a").value();
    EXPECT_TRUE(stream_->claim(sender_));
    announce();
  }
  void announce() {
    EXPECT_TRUE(stream_->announce(small_announce(), ++epoch_));
    sender_.tag = stream_->tag();
    sender_.begin_anew();
  }
  void watch(MemoryViewer& viewer, const Profile& profile = kRaw) {
    viewer.watched = stream_;
    ASSERT_TRUE(stream_->watch(viewer, profile));
  }
  void remember(int first, int count) {
    auto segments = stream_->memory() ? stream_->memory()->segments : std::vector<Generation::Segment>();
    segments.push_back(segment_of(first, count));
    ASSERT_TRUE(hub_->remember(*stream_, std::move(segments)));
  }
  /// The viewer fetches what it was told of, and says so.
  void hold(MemoryViewer& viewer) {
    viewer.memory = stream_->memory()->poses;
    stream_->note_held(viewer, stream_->memory()->number);
  }
  Result<void> add(const Bytes& message) {
    auto added = stream_->add_frame(message, now_);
    for (const TimeUs end = now_ + testing::kInterval; now_ < end; now_ += 1000) stream_->pump(now_);
    return added;
  }
  void plain_key() { ASSERT_TRUE(add(sender_.next(now_))); }
  void recalled_key(std::uint32_t phase) {
    const auto added = add(sender_.next_recalled(now_, stream_->memory()->poses, phase));
    ASSERT_TRUE(added) << added.error().message;
  }
  /// It watches, holds a memory of ten poses, and has a key from it.
  void recall(MemoryViewer& viewer) {
    watch(viewer);
    plain_key();
    remember(0, 10);
    hold(viewer);
    recalled_key(8);
  }

  TimeUs now_ = 1'000'000;
  std::uint32_t epoch_ = 0;
  FakeSender sender_;
  std::unique_ptr<Hub> hub_;
  Stream* stream_ = nullptr;
};

/// As a viewer sees the newest key.
const Key& last(const MemoryViewer& viewer) {
  return viewer.poses.back().key;
}

TEST_F(MemoryTest, WhoHoldsItGetsTheSendersBytesAndOthersAPlainChain) {
  MemoryViewer holds, lacks;
  watch(holds);
  watch(lacks);
  plain_key();
  remember(0, 30);
  EXPECT_EQ(holds.told, lacks.told);
  ASSERT_EQ(holds.told.size(), 1U);
  hold(holds);
  plain_key();
  EXPECT_EQ(holds.restarts + lacks.restarts, 0) << "no key needs it yet";
  EXPECT_EQ(lacks.frames.back(), holds.frames.back());
  for (std::uint32_t i = 2; i < 28; ++i) {
    const Bytes message = sender_.next_recalled(now_, stream_->memory()->poses, 8 * i);
    ASSERT_TRUE(add(message));
    EXPECT_EQ(last(holds), sender_.sent()) << i;
    const ByteView sent = ByteView(message).last(8), got = holds.frames.back()->message().last(8);
    EXPECT_TRUE(std::equal(sent.begin(), sent.end(), got.begin())) << "as the sender coded it";
    // The plain chain codes the key anew, at half the spacing of the sender's.
    for (std::size_t v = 0; v < sender_.sent().q.size(); ++v)
      ASSERT_NEAR(last(lacks).q[v], sender_.sent().q[v], 8) << i;
  }
  EXPECT_EQ(holds.recalled(), 26);
  EXPECT_EQ(lacks.recalled(), 0);
  EXPECT_EQ(holds.restarts, 0);
  EXPECT_EQ(lacks.restarts, 1);
  EXPECT_EQ(holds.undecodable + lacks.undecodable, 0);
  // It comes to hold it: a join, then the sender's bytes.
  hold(lacks);
  EXPECT_EQ(lacks.restarts, 2);
  EXPECT_EQ(last(lacks), sender_.sent());
  EXPECT_TRUE(lacks.frames.back()->envelope.is_recalled()) << "the join says where in the memory its newer key is";
  plain_key();
  EXPECT_EQ(lacks.frames.back(), holds.frames.back()) << "one encoding for both";
  EXPECT_EQ(lacks.undecodable, 0);
}

TEST_F(MemoryTest, ViewersThatComeLaterBeginAsWhatTheyHold) {
  plain_key();
  remember(0, 20);
  for (std::uint32_t i = 1; i < 5; ++i) recalled_key(8 * i);
  MemoryViewer late, fewer;
  watch(late);
  Profile band = kRaw;
  band.bands = 1;
  watch(fewer, band);
  EXPECT_EQ(late.recalled() + fewer.recalled(), 0);
  EXPECT_EQ(last(late), sender_.sent()) << "the plain chain begins at the sender's state";
  recalled_key(40);
  hold(late);
  hold(fewer);
  for (std::uint32_t i = 6; i < 12; ++i) {
    recalled_key(8 * i + 3);
    EXPECT_EQ(last(late), sender_.sent());
    EXPECT_TRUE(fewer.frames.back()->envelope.is_recalled());
    EXPECT_TRUE(std::equal(last(fewer).q.begin(), last(fewer).q.begin() + 12, sender_.sent().q.begin()));
  }
  EXPECT_EQ(late.undecodable + fewer.undecodable, 0);
  Profile other = kLinear;
  ASSERT_TRUE(stream_->watch(late, other));
  recalled_key(100);
  recalled_key(108);
  EXPECT_EQ(late.undecodable, 0) << "what it holds outlives a change of its profile";
  EXPECT_TRUE(late.frames.back()->envelope.kind == FrameKind::kStep || late.frames.back()->envelope.is_recalled());
}

TEST_F(MemoryTest, InterpolatedPosesOfBothChainsAreWhatTheirKeysSay) {
  MemoryViewer holds, lacks;
  watch(holds, kLinear);
  watch(lacks, testing::kCurved);
  plain_key();
  remember(0, 30);
  hold(holds);
  for (std::uint32_t i = 1; i < 25; ++i) recalled_key(8 * i);
  EXPECT_EQ(holds.undecodable + lacks.undecodable, 0);
  EXPECT_GT(holds.recalled(), 20);
  EXPECT_EQ(lacks.recalled(), 0);
  EXPECT_GT(lacks.poses.size(), 40U);
}

TEST_F(MemoryTest, AppendedPosesMoveViewersOnlyOnceAKeyNeedsThem) {
  MemoryViewer first, both;
  watch(first);
  watch(both);
  plain_key();
  remember(0, 10);
  hold(first);
  hold(both);
  recalled_key(8);
  remember(10, 10);
  EXPECT_EQ(first.told.size(), 2U);
  hold(both);
  recalled_key(16);
  EXPECT_EQ(first.restarts, 0) << "the poses that it holds are enough";
  recalled_key(8 * 12);
  EXPECT_EQ(first.restarts, 1);
  EXPECT_FALSE(first.frames.back()->envelope.is_recalled());
  EXPECT_EQ(both.restarts, 0);
  recalled_key(24);
  EXPECT_FALSE(first.frames.back()->envelope.is_recalled()) << "the state was in poses that it lacks";
  hold(first);
  recalled_key(8 * 13);
  EXPECT_EQ(last(first), sender_.sent());
  EXPECT_EQ(first.undecodable + both.undecodable, 0);
}

TEST_F(MemoryTest, ANewRootRestartsThoseWhoseKeysNeededTheOld) {
  MemoryViewer viewer;
  recall(viewer);
  const std::uint32_t old = stream_->memory()->number;
  stream_->set_memory(nullptr);
  sender_.forget_phase();
  EXPECT_EQ(viewer.restarts, 1);
  EXPECT_FALSE(viewer.frames.back()->envelope.is_recalled());
  remember(30, 10);
  EXPECT_EQ(viewer.restarts, 1);
  stream_->note_held(viewer, old);
  recalled_key(40);
  EXPECT_FALSE(viewer.frames.back()->envelope.is_recalled()) << "what it holds is another memory's";
  stream_->note_held(viewer, stream_->memory()->number + 1);
  recalled_key(48);
  EXPECT_FALSE(viewer.frames.back()->envelope.is_recalled()) << "nobody holds what there is not";
  EXPECT_EQ(viewer.undecodable, 0);
  hold(viewer);
  recalled_key(56);
  EXPECT_EQ(last(viewer), sender_.sent());
}

TEST_F(MemoryTest, ANewEpochHasNone) {
  MemoryViewer viewer;
  recall(viewer);
  const PoseMemory poses = stream_->memory()->poses;
  announce();
  EXPECT_EQ(stream_->memory(), nullptr);
  plain_key();
  const auto refused = add(sender_.next_recalled(now_, poses, 8));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(MemoryTest, FramesOfPosesThatAreNotThereAreRefusedAndChangeNothing) {
  plain_key();
  PoseMemory more(small_layout());
  more = more.with(segment_of(0, 20).poses).value();
  EXPECT_EQ(add(FakeSender(sender_).next_recalled(now_, more, 8)).error().code, ErrorCode::kCorrupt) << "no memory";
  remember(0, 10);
  EXPECT_EQ(add(FakeSender(sender_).next_recalled(now_, more, 8 * 15)).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(add(FakeSender(sender_).next_recalled(now_, more, 8 * 9 + 1)).error().code, ErrorCode::kCorrupt);
  recalled_key(16);
}

TEST_F(MemoryTest, PosesAreChargedAndGivenBack) {
  remember(0, 100);
  const std::int64_t bytes = hub_->memory_bytes();
  EXPECT_GE(bytes, 100 * 24 * 4);
  remember(100, 100);
  const std::int64_t both = hub_->memory_bytes();
  EXPECT_GE(both, bytes + 100 * 24 * 4);
  auto segments = stream_->memory()->segments;
  segments.push_back(segment_of(200, 300));
  EXPECT_EQ(hub_->remember(*stream_, segments).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(hub_->memory_bytes(), both);
  EXPECT_EQ(stream_->memory()->poses.pose_count(), 200U) << "what it had stays";
  stream_->set_memory(nullptr);
  segments.clear();
  EXPECT_EQ(hub_->memory_bytes(), 0);
}

TEST_F(MemoryTest, CodingKeysAnewIsPaidByWhatItMakes) {
  struct Payer : MemoryViewer {
    bool take_key(double work_us) override { return charge_key(work_us), true; }
    void charge_key(double work_us) override { keys_us += work_us; }
    double keys_us = 0;
  } viewer;
  watch(viewer);
  plain_key();
  remember(0, 30);
  recalled_key(8);
  viewer.keys_us = 0;
  (void)stream_->take_unpaid_us();
  double made_us = 0;
  for (std::uint32_t i = 0; i < 20; ++i) {
    recalled_key(i % 2 == 0 ? 8 * 28 : 8 * 2);  // To and fro: few bytes of the sender, many without its memory.
    made_us += encoding_us(small_layout(), stream_->plain()->payload.size());
  }
  EXPECT_GE(viewer.keys_us, made_us + 20 * 5);
  EXPECT_GE(stream_->take_unpaid_us(), made_us) << "its sender, too: viewers at many addresses have many budgets";
  stream_->unwatch(viewer);
  recalled_key(8);
  EXPECT_DOUBLE_EQ(stream_->take_unpaid_us(), static_cast<double>(small_layout().size()) / 250)
      << "what recalling takes beside decoding: nobody needs it coded anew";
  EXPECT_GT(encoding_us(small_layout(), stream_->plain()->payload.size()), 0);
  EXPECT_GT(stream_->take_unpaid_us(), 0) << "the sender pays for recordings and other brokers";
}

TEST_F(MemoryTest, ChangesOfChainsArePaidByTheSender) {
  constexpr double kChangeUs = 5;
  std::vector<MemoryViewer> viewers(20);
  for (MemoryViewer& viewer : viewers) watch(viewer);
  plain_key();
  remember(0, 30);
  EXPECT_DOUBLE_EQ(stream_->take_unpaid_us(), 20 * Stream::kOfferUs) << "a key";
  recalled_key(8);
  EXPECT_GE(stream_->take_unpaid_us(), 20 * kChangeUs) << "they lack it";
  for (MemoryViewer& viewer : viewers) hold(viewer);
  EXPECT_GE(stream_->take_unpaid_us(), 20 * kChangeUs) << "they have it";
  for (MemoryViewer& viewer : viewers) EXPECT_EQ(viewer.restarts, 2);
  for (MemoryViewer& viewer : viewers) stream_->unwatch(viewer);
}

TEST_F(MemoryTest, ViewersThatComeAndGoCostTheSenderNothing) {
  plain_key();
  remember(0, 30);
  recalled_key(8);
  MemoryViewer stays;
  watch(stays);
  hold(stays);
  (void)stream_->take_unpaid_us();
  for (int i = 0; i < 20; ++i) {
    MemoryViewer viewer;
    watch(viewer);
    hold(viewer);
    EXPECT_EQ(viewer.restarts, 1);
    stream_->unwatch(viewer);
  }
  EXPECT_EQ(stream_->take_unpaid_us(), 0);
  remember(30, 10);
  recalled_key(8 * 35);
  hold(stays);
  EXPECT_GT(stream_->take_unpaid_us(), 2 * 5.0) << "what the sender brings about";
  stream_->unwatch(stays);
}

TEST_F(MemoryTest, PosesThatAreKeptAreChargedOnce) {
  remember(0, 100);
  const std::int64_t bytes = hub_->memory_bytes();
  const MemorySegment* poses = stream_->memory()->segments[0].poses.get();
  for (int i = 0; i < 10; ++i) {
    auto kept = stream_->memory()->segments;
    stream_->set_memory(nullptr);
    ASSERT_TRUE(hub_->remember(*stream_, std::move(kept))) << i;
    EXPECT_EQ(hub_->memory_bytes(), bytes) << i;
  }
  EXPECT_EQ(stream_->memory()->segments[0].poses.get(), poses);
  EXPECT_EQ(stream_->memory()->needed_at(8), stream_->memory()->number) << "who held it before does not hold this one";
}

/// For recordings and other brokers.
TEST_F(MemoryTest, ThePlainChainGoesOnFromKeyToKey) {
  plain_key();
  remember(0, 30);
  recalled_key(8);
  KeyRecordPtr before = stream_->plain();
  EXPECT_EQ(before->generation, 0U);
  EXPECT_FALSE(before->before) << "it begins with the first that is asked for";
  for (std::uint32_t i = 2; i < 20; ++i) {
    recalled_key(8 * i);
    const KeyRecordPtr record = stream_->plain();
    EXPECT_EQ(record->sequence, before->sequence + 1);
    EXPECT_EQ(record->before, before->after);
    EXPECT_FALSE(record->after->phase);
    EXPECT_EQ(decode_key(small_layout(), record->bands, *before->after, record->payload).value(), record->after->newer);
    before = record;
  }
  recalled_key(8);
  recalled_key(16);
  EXPECT_FALSE(stream_->plain()->before) << "a gap begins it anew";
  recalled_key(24);
  EXPECT_TRUE(stream_->plain()->before);
  stream_->set_memory(nullptr);
  sender_.forget_phase();
  plain_key();
  EXPECT_FALSE(stream_->plain()->before) << "the sender's state is another: it goes on as the sender's, from a join on";
  EXPECT_EQ(stream_->plain()->after->newer, sender_.sent());
  plain_key();
  EXPECT_EQ(stream_->plain(), stream_->snapshot().newest);
}

}  // namespace
}  // namespace eigencast::broker
