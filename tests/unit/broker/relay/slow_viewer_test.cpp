// SPDX-License-Identifier: MIT
//
// What viewers show (docs/protocol.md, section 6) whose sockets and windows open and close at any time, while keys come
// in bursts and frames wait for deliver().
#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <random>

#include "broker/relay/outbox.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using namespace testing;

constexpr std::uint32_t kSlowStream = 7;

class Dice {
 public:
  explicit Dice(unsigned seed) : random_(seed) {}
  bool one_in(unsigned n) { return random_() % n == 0; }
  TimeUs below(TimeUs n) { return static_cast<TimeUs>(random_() % static_cast<std::uint32_t>(n)); }

 private:
  std::mt19937 random_;
};

/// A receiver behind an outbox and a socket, which are used as Connection does.
class SlowViewer : public FakeReceiver {
 public:
  SlowViewer(Stream& stream, Dice& dice, const TimeUs& now) : stream_(stream), dice_(dice), now_(now) {}

  void on_stream_changed(const Stream& stream, bool restart) override {
    FakeReceiver::on_stream_changed(stream, restart);
    if (restart) outbox_.open_lane(stream.id());
  }
  void on_frames(const Stream&, std::span<const FramePtr> received) override {
    if (received.size() == 1 && !blocked_ && queue_.empty() &&
        outbox_.send_directly(kSlowStream, *received.front(), now_)) {
      queue_.push_back(received.front());
      return write(steady_ || !dice_.one_in(8) ? 1 : 0);
    }
    for (const FramePtr& frame : received) {
      outbox_.offer(kSlowStream, frame);
      fill();
    }
  }

  bool take_key(double) override { return !is_poor_ || steady_ || !dice_.one_in(20); }
  void become_poor() { is_poor_ = true; }

  /// The socket takes `most` frames and may begin one more; it is full if others are left.
  void write(std::size_t most) {
    for (; most > 0 && !queue_.empty(); --most) {
      take_in(*queue_.front());
      queue_.pop_front();
    }
    if (queue_.empty()) return fill();
    blocked_ = true;
    const std::size_t begun = dice_.one_in(2) ? 1 : 0;
    for (std::size_t i = begun; i < queue_.size(); ++i) outbox_.drop_unsent(queue_[i]);
    queue_.resize(std::min(begun, queue_.size()));
  }
  void unblock() {
    blocked_ = false;
    fill();
  }
  void acknowledge() {
    if (frames.empty()) return;
    const Envelope& head = frames.back()->envelope;
    outbox_.acknowledge({head.stream_id, head.sequence, head.step.byte()}, now_);
  }
  void fill() {
    while (!blocked_ && queue_.size() < 6) {
      auto item = outbox_.take(now_, [&](std::uint32_t) { return stream_.join_for(*this); });
      if (!item) return;
      queue_.push_back(std::move(item->frame));
    }
  }
  /// From now on the socket takes everything.
  void read_all() {
    steady_ = true;
    unblock();
    while (!queue_.empty()) write(queue_.size());
    acknowledge();
  }
  bool is_blocked() const { return blocked_; }
  std::uint64_t joins() const { return outbox_.joins_total(); }

 private:
  void take_in(const Frame& frame) {
    const std::size_t shown = poses.size();
    on_frame(frame.shared_from_this());
    if (poses.size() > shown) check(shown);
  }
  void check(std::size_t i) {
    const Pose& pose = poses[i];
    const Envelope& head = pose.envelope;
    const Profile& profile = infos.back().profile;
    if (head.kind == FrameKind::kKey || head.kind == FrameKind::kJoin) {
      EXPECT_EQ(pose.key, key_number(static_cast<int>(head.sequence)));
    }
    if (i == 0) return;
    const Envelope& before = poses[i - 1].envelope;
    EXPECT_GE(head.sequence, before.sequence);
    if (profile.rate == Profile::Rate::kEstimated && head.sequence > before.sequence) return;  // A correction.
    EXPECT_GE(head.capture_us, before.capture_us)
        << static_cast<int>(head.kind) << " of " << head.sequence << " (" << int{head.step.at} << "/"
        << int{head.step.of} << ") after " << static_cast<int>(before.kind) << " of " << before.sequence << " ("
        << int{before.step.at} << "/" << int{before.step.of} << ")";
  }

  Stream& stream_;
  Dice& dice_;
  const TimeUs& now_;
  Outbox outbox_;
  std::deque<FramePtr> queue_;
  bool blocked_ = false, steady_ = false, is_poor_ = false;
};

/// A sender whose keys come in bursts, a stream, and a viewer of it.
class SlowScene {
 public:
  SlowScene(const Profile& profile, unsigned seed) : dice_(seed) {
    EXPECT_TRUE(stream_.claim(sender_));
    EXPECT_TRUE(stream_.announce(small_announce(), 1));
    EXPECT_TRUE(stream_.watch(viewer_, profile));
  }

  void play(int turns) {
    for (int i = 0; i < turns; ++i) {
      now_ += dice_.below(dice_.one_in(20) ? 40'000 : 4'000);
      if (now_ >= next_key_us_) make_key();
      if (dice_.one_in(12)) held_ = !held_;
      if (!held_) arrive();
      if (dice_.one_in(2)) pump();
      if (dice_.one_in(3)) stream_.deliver();
      use_socket();
    }
  }
  /// The sender pauses; the viewer reads all only in the end.
  void pause() {
    held_ = false;
    for (int i = 0; i < 700; ++i) {
      now_ += 2'000;
      arrive();
      pump();
      stream_.deliver();
      use_socket();
    }
    viewer_.read_all();
  }
  /// Regular keys, and a viewer that reads them.
  void calm() {
    held_ = false;
    for (int i = 0; i < 700; ++i) {
      now_ += 2'000;
      if (i % 15 == 0 && i < 300) way_.push_back(sender_.next(newest_us_ = now_));
      arrive();
      viewer_.read_all();
      pump();
      stream_.deliver();
      viewer_.read_all();
    }
  }

  Dice dice_;
  TimeUs now_ = 1'000'000, newest_us_ = 0;
  Stream stream_{"a", kSlowStream, Stream::Settings{}};
  SlowViewer viewer_{stream_, dice_, now_};

 private:
  void make_key() {
    if (dice_.one_in(40)) sender_.begin_anew();
    way_.push_back(sender_.next(newest_us_ = now_));
    constexpr TimeUs kSpacings[]{600, 2'000, 20'000, 33'000, 33'000, 100'000};
    next_key_us_ = now_ + (dice_.one_in(60) ? 700'000 : kSpacings[dice_.below(std::size(kSpacings))]);
  }
  void arrive() {
    for (const Bytes& message : std::exchange(way_, {})) {
      EXPECT_TRUE(stream_.take_frame(message, now_));
      if (dice_.one_in(4)) stream_.deliver();
      now_ += dice_.below(300);
    }
  }
  void pump() {
    const auto due = stream_.next_due_us();
    if (due && *due <= now_) stream_.pump(now_);
  }
  void use_socket() {
    if (viewer_.is_blocked()) {
      if (dice_.one_in(10)) viewer_.unblock();
      return;
    }
    if (dice_.one_in(2)) viewer_.write(static_cast<std::size_t>(1 + dice_.below(6)));
    if (dice_.one_in(5)) viewer_.acknowledge();
    if (dice_.one_in(10)) viewer_.fill();
  }

  FakeSender sender_;
  std::deque<Bytes> way_;
  bool held_ = false;
  TimeUs next_key_us_ = 0;
};

class SlowViewerTest : public ::testing::TestWithParam<Profile> {};

TEST_P(SlowViewerTest, NeverShowsOlderPose) {
  std::uint64_t joins = 0;
  for (unsigned seed = 0; seed < 150 && !HasFailure(); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    SlowScene scene(GetParam(), seed);
    SlowViewer& viewer = scene.viewer_;
    if (seed % 2 == 1) viewer.become_poor();
    scene.play(1500);
    scene.calm();
    joins += viewer.joins();
    EXPECT_EQ(viewer.undecodable, 0);
    ASSERT_FALSE(viewer.poses.empty());
    if (GetParam().rate != Profile::Rate::kEstimated) {
      EXPECT_EQ(viewer.poses.back().envelope.capture_us, scene.newest_us_) << "steps follow what was not shown";
    }
  }
  EXPECT_GT(joins, 700u) << "viewers missed keys";
}

TEST_P(SlowViewerTest, ShowsTheLastPoseOfASenderThatPauses) {
  if (GetParam().rate == Profile::Rate::kEstimated) return;  // Estimates go on.
  for (unsigned seed = 0; seed < 150 && !HasFailure(); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    SlowScene scene(GetParam(), seed);
    if (seed % 2 == 1) scene.viewer_.become_poor();
    scene.play(300);
    scene.pause();
    ASSERT_FALSE(scene.viewer_.poses.empty());
    EXPECT_EQ(scene.viewer_.poses.back().envelope.capture_us, scene.newest_us_);
  }
}

using Rate = Profile::Rate;
const Profile kSlowProfiles[]{
    kRaw, kLinear, kCurved, {Rate::kInterpolated, 7}, {Rate::kEstimated, 3, 8, Profile::Scheme::kDamped}};
INSTANTIATE_TEST_SUITE_P(Profiles, SlowViewerTest, ::testing::ValuesIn(kSlowProfiles));

}  // namespace
}  // namespace eigencast::broker
