// SPDX-License-Identifier: MIT
#include "broker/relay/mirror.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <random>

#include "tests/unit/broker/support.h"

// One stream in three loops without threads: what travels between them waits in queues until the test lets it go on.
namespace eigencast::broker {
namespace {

using testing::FakeAccount;
using testing::FakeReceiver;
using testing::FakeSender;
using testing::key_number;
using testing::kLinear;
using testing::kRaw;
using testing::large_announce;
using testing::large_message;
using testing::small_announce;
using State = control::StreamInfo::State;

/// Takes joins as a connection does: on a restart.
class Viewer : public FakeReceiver {
 public:
  void on_stream_changed(const Stream& stream, bool restart) override {
    FakeReceiver::on_stream_changed(stream, restart);
    if (!restart) return;
    if (const FramePtr join = watched->join_for(*this)) decode(*join);
  }
  Stream* watched = nullptr;
};

class MirrorTest : public ::testing::Test {
 protected:
  struct Away {
    std::unique_ptr<MirrorSet> mirrors;
    std::unique_ptr<Hub> hub;
    std::deque<MirrorEvents> inbox;
    std::uint64_t taken = 0;
    bool settles = false;
  };

  MirrorTest() {
    Hub::Settings settings;
    settings.ids = std::make_shared<StreamIds>();
    mirrored_ = std::make_unique<MirrorOrigin>(
        2, MirrorOrigin::Environment{
               [this](std::size_t loop, MirrorEvents events) { away_[loop].inbox.push_back(std::move(events)); },
               [this](std::size_t loop) { return away_[loop].taken; }, [this] { flushes_ = true; }});
    for (std::size_t i = 0; i < 2; ++i) {
      Away& away = away_[i];
      away.mirrors = std::make_unique<MirrorSet>(
          MirrorSet::Environment{[this, i](MirrorRequests requests) { asked_.emplace_back(i, std::move(requests)); },
                                 [&away] { away.settles = true; }});
      settings.on_opened = [&away](Stream& stream) { away.mirrors->on_opened(stream); };
      away.hub = std::make_unique<Hub>(settings);
    }
    settings.on_opened = {};
    settings.stream.taps = {mirrored_.get()};
    origin_ = std::make_unique<Hub>(settings);
  }

  Hub& hub(std::size_t loop) { return loop == 0 ? *origin_ : *away_[loop - 1].hub; }

  /// One thing that waits goes on, if there is one of that sort.
  bool step(std::size_t which) {
    if (which == 0) {
      if (!std::exchange(flushes_, false)) return false;
      mirrored_->flush();
    } else if (which == 1) {
      if (asked_.empty()) return false;
      const auto [loop, requests] = std::move(asked_.front());
      asked_.pop_front();
      mirrored_->take(*origin_, loop, requests);
    } else if (which < 4) {
      Away& away = away_[which - 2];
      if (!std::exchange(away.settles, false)) return false;
      away.mirrors->flush(*away.hub);
    } else {
      Away& away = away_[which - 4];
      if (away.inbox.empty()) return false;
      const MirrorEvents events = std::move(away.inbox.front());
      away.inbox.pop_front();
      for (const MirrorEvent& event : events) away.taken += cost_of(event);
      away.mirrors->take(*away.hub, events, now_);
      away.hub->deliver();
    }
    return true;
  }
  static constexpr std::size_t kSteps = 6;
  void flush() {
    for (bool moved = true; moved;) {
      moved = false;
      for (std::size_t i = 0; i < kSteps; ++i) moved = step(i) || moved;
    }
  }

  void watch(Viewer& viewer, std::size_t loop, const Profile& profile, const std::string& name = "a") {
    viewer.watched = hub(loop).open(name).value();
    ASSERT_TRUE(viewer.watched->watch(viewer, profile));
    hub(loop).mark_dirty(*viewer.watched);
  }
  void leave(Viewer& viewer, std::size_t loop) {
    Stream* stream = std::exchange(viewer.watched, nullptr);
    stream->unwatch(viewer);
    hub(loop).unwatched(*stream);
  }
  void begin() {
    stream_ = origin_->open("a").value();
    ASSERT_TRUE(stream_->claim(sender_));
    sender_.begin_anew();
    ASSERT_TRUE(origin_->admit(*stream_, {"sender"}, small_announce().format, account_.charge()));
    ASSERT_TRUE(stream_->announce(small_announce(), ++epoch_));
    sender_.tag = stream_->tag();
  }
  void publish() {
    now_ += 30'000;
    ASSERT_TRUE(stream_->take_frame(sender_.next(now_), now_));
    origin_->mark_dirty(*stream_);
    origin_->deliver();
    ++keys_;
  }

  TimeUs now_ = 1'000'000;
  std::uint32_t epoch_ = 0;
  int keys_ = 0;
  FakeAccount account_;
  FakeSender sender_;
  std::unique_ptr<MirrorOrigin> mirrored_;
  std::array<Away, 2> away_;
  std::unique_ptr<Hub> origin_;
  Stream* stream_ = nullptr;
  std::deque<std::pair<std::size_t, MirrorRequests>> asked_;
  bool flushes_ = false;
};

TEST_F(MirrorTest, LoopsMakeTheSameFrames) {
  begin();
  std::array<Viewer, 3> raw;
  std::array<Viewer, 3> full;
  for (std::size_t loop = 0; loop < 3; ++loop) {
    watch(raw[loop], loop, kRaw);
    watch(full[loop], loop, kLinear);
  }
  flush();
  for (int i = 0; i < 10; ++i) {
    publish();
    flush();
    for (int ms = 0; ms < 30; ++ms) {
      for (std::size_t loop = 0; loop < 3; ++loop) {
        hub(loop).pump(now_ + ms * 1000);
        hub(loop).deliver();
      }
    }
  }
  EXPECT_EQ(raw[0].frames.size(), 10u);
  EXPECT_GE(full[0].frames.size(), 25u);
  for (const auto& viewers : {std::cref(raw), std::cref(full)}) {
    for (std::size_t loop = 1; loop < 3; ++loop) {
      const Viewer& there = viewers.get()[loop];
      const Viewer& here = viewers.get()[0];
      ASSERT_EQ(there.frames.size(), here.frames.size());
      for (std::size_t i = 0; i < here.frames.size(); ++i) {
        EXPECT_EQ(there.frames[i]->wire, here.frames[i]->wire) << loop << ", frame " << i;
      }
      EXPECT_EQ(there.undecodable, 0);
    }
  }
}

TEST_F(MirrorTest, NewWatcherGetsOneSnapshot) {
  Viewer early;
  watch(early, 1, kRaw);
  EXPECT_TRUE(early.infos.empty()) << "no snapshot yet";
  flush();
  ASSERT_EQ(early.infos.size(), 1u);
  EXPECT_EQ(early.infos[0].state, State::kWaiting);
  begin();
  publish();
  flush();
  ASSERT_EQ(early.infos.size(), 2u);
  EXPECT_EQ(early.infos[1].state, State::kLive);
  EXPECT_EQ(early.infos[1].epoch, epoch_);
  Viewer late;
  watch(late, 2, kRaw);
  flush();
  ASSERT_EQ(late.infos.size(), 1u);
  EXPECT_EQ(late.infos[0].state, State::kLive);
  EXPECT_EQ(late.infos[0].stream_id, early.infos[0].stream_id);
  ASSERT_EQ(late.poses.size(), 1u) << "the present pose";
  EXPECT_EQ(late.poses[0].key, key_number(0));
  stream_->release(sender_);
  flush();
  EXPECT_EQ(late.infos.back().state, State::kStalled);
  Viewer after;
  watch(after, 2, kRaw);
  leave(early, 1);
  flush();
  watch(early, 1, kRaw);
  flush();
  for (const Viewer* viewer : {&after, &early}) {
    EXPECT_EQ(viewer->infos.back().state, State::kStalled);
    EXPECT_EQ(viewer->poses.back().key, key_number(0)) << "the last pose is held";
  }
  begin();
  flush();
  for (const Viewer* viewer : {&late, &after, &early}) EXPECT_EQ(viewer->infos.back().epoch, epoch_);
}

TEST_F(MirrorTest, SenderLearnsWatchersAndTracesOfAllLoops) {
  begin();
  std::array<Viewer, 3> viewers;
  for (std::size_t loop = 0; loop < 3; ++loop) watch(viewers[loop], loop, kRaw);
  flush();
  EXPECT_EQ(sender_.counts.back(), 3u);
  EXPECT_EQ(viewers[2].watched->watchers(), 3u);
  viewers[1].watched->trace(viewers[1], 6);
  viewers[2].watched->trace(viewers[2], 4);
  flush();
  EXPECT_EQ(stream_->trace_every(), 4u);
  control::Trace trace;
  trace.sequence = 12;
  trace.stages = {{"made", 1}};
  stream_->relay_trace(trace);
  flush();
  EXPECT_EQ(viewers[0].traces.size(), 0u);
  EXPECT_EQ(viewers[1].traces.size(), 1u);
  EXPECT_EQ(viewers[2].traces, viewers[1].traces);
  leave(viewers[2], 2);
  flush();
  EXPECT_EQ(stream_->trace_every(), 6u);
  EXPECT_EQ(sender_.counts.back(), 2u);
  leave(viewers[1], 1);
  leave(viewers[0], 0);
  flush();
  EXPECT_EQ(sender_.counts.back(), 0u);
  EXPECT_EQ(stream_->trace_every(), 0u);
  EXPECT_EQ(hub(1).size() + hub(2).size(), 0u) << "no watchers, no mirror";
}

TEST_F(MirrorTest, WatchersOfAllLoopsCountTowardsTheLimit) {
  Hub::Settings settings;
  settings.stream.max_watchers = 2;
  settings.ids = std::make_shared<StreamIds>();
  Hub one(settings);
  Hub two(settings);
  std::array<Viewer, 3> viewers;
  Stream* here = one.open("a").value();
  Stream* there = two.open("a").value();
  EXPECT_EQ(here->id(), there->id());
  for (Viewer& viewer : viewers) viewer.watched = there;
  ASSERT_TRUE(there->watch(viewers[0], kRaw));
  ASSERT_TRUE(there->watch(viewers[1], kRaw));
  viewers[2].watched = here;
  EXPECT_EQ(here->watch(viewers[2], kRaw).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(here->watchers(), 2u);
  there->unwatch(viewers[0]);
  EXPECT_TRUE(here->watch(viewers[2], kRaw));
  two.drop(*two.open("b").value());
  EXPECT_NE(two.open("b").value()->id(), here->id());
}

TEST_F(MirrorTest, SlowLoopResumesFromSnapshot) {
  begin();
  Viewer viewer;
  watch(viewer, 1, kRaw);
  flush();
  publish();
  flush();
  const std::size_t before = viewer.frames.size();
  for (std::uint64_t i = 0; i < MirrorOrigin::kMaxInFlight + 100; ++i) {
    publish();
    step(0);
  }
  std::uint64_t waiting = 0;
  for (const MirrorEvents& events : away_[0].inbox) waiting += events.size();
  EXPECT_LE(waiting, MirrorOrigin::kMaxInFlight);
  away_[0].taken += waiting;  // As if each had been dealt with, and nothing else came.
  away_[0].inbox.clear();
  mirrored_->flush();
  flush();
  EXPECT_EQ(viewer.frames.size(), before) << "no backlog";
  EXPECT_EQ(viewer.poses.back().key, key_number(keys_ - 1));
  publish();
  flush();
  EXPECT_EQ(viewer.poses.back().key, key_number(keys_ - 1));
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(MirrorTest, SlowLoopHoldsFewLargeKeys) {
  begin();
  Viewer viewer;
  watch(viewer, 1, kRaw);
  ASSERT_TRUE(stream_->announce(large_announce(), ++epoch_));
  flush();
  for (std::uint64_t i = 0; i < 1000; ++i) {
    now_ += 1000;
    ASSERT_TRUE(stream_->add_frame(large_message(*stream_, i, now_), now_));
    step(0);
  }
  std::size_t bytes = 0;
  for (const MirrorEvents& events : away_[0].inbox) {
    for (const MirrorEvent& event : events) {
      const auto* record = std::get_if<KeyRecordPtr>(&event.what);
      if (record != nullptr) bytes += memory_of(**record);
    }
  }
  EXPECT_LE(bytes, 64u << 20) << "of 262 MB";
  EXPECT_GT(bytes, 32u << 20);
  flush();
  now_ += 1000;
  ASSERT_TRUE(stream_->add_frame(large_message(*stream_, 1000, now_), now_));
  mirrored_->flush();
  flush();
  EXPECT_EQ(viewer.watched->snapshot().newest->sequence, 1000u) << "it goes on";
}

TEST_F(MirrorTest, NamesAreChargedOnceInAllLoops) {
  FakeAccount account(1);
  Viewer here, there;
  here.watched = hub(0).open("a", account.charge()).value();
  ASSERT_TRUE(here.watched->watch(here, kRaw));
  there.watched = hub(1).open("a", account.charge()).value();
  ASSERT_TRUE(there.watched->watch(there, kRaw));
  EXPECT_EQ(hub(1).open("b", account.charge()).error().code, ErrorCode::kRefused);
  EXPECT_EQ(hub(2).size(), 0u);
  leave(here, 0);
  flush();
  EXPECT_EQ(account.held(), 1u) << "somebody watches it still";
  begin();
  EXPECT_EQ(account.held(), 0u) << "a sender has announced it";
  flush();
  EXPECT_EQ(there.infos.back().state, State::kLive);
  EXPECT_TRUE(hub(2).open("a", account.charge()));
  EXPECT_EQ(account.held(), 0u);
}

/// Random orders of events: in the end every viewer has the current pose and could decode every frame.
TEST_F(MirrorTest, RandomOrdersConverge) {
  std::mt19937 random(7);
  const auto pick = [&](std::size_t count) { return std::uniform_int_distribution<std::size_t>(0, count - 1)(random); };
  std::array<Viewer, 9> viewers;
  bool live = false;
  for (int round = 0; round < 4000; ++round) {
    Viewer& viewer = viewers[pick(viewers.size())];
    const std::size_t loop = static_cast<std::size_t>(&viewer - viewers.data()) % 3;
    switch (pick(8)) {
      case 0:
        if (viewer.watched != nullptr) leave(viewer, loop);
        break;
      case 1:
        watch(viewer, loop, kRaw);
        break;
      case 2:
        if (live && pick(8) == 0) {
          stream_->release(sender_);
          origin_->unwatched(*stream_);
          live = false;
        }
        break;
      case 3:
        if (!live) begin();
        live = true;
        break;
      case 4:
        if (live) publish();
        break;
      default:
        step(pick(kSteps));
    }
    if (round % 50 != 49) continue;
    if (live) publish();
    flush();
    std::uint32_t watching = 0;
    for (const Viewer& one : viewers) {
      if (one.watched == nullptr) continue;
      ++watching;
      ASSERT_EQ(one.undecodable, 0) << "round " << round;
      ASSERT_FALSE(one.infos.empty());
      ASSERT_EQ(one.infos.back().epoch, epoch_);
      if (live) {
        ASSERT_EQ(one.poses.back().key, key_number(keys_ - 1)) << "round " << round;
      }
    }
    if (stream_ != nullptr) {
      ASSERT_EQ(stream_->watchers(), watching);
    }
    if (live) {
      ASSERT_EQ(sender_.counts.back(), watching);
    }
  }
  for (std::size_t i = 0; i < viewers.size(); ++i) {
    if (viewers[i].watched != nullptr) leave(viewers[i], i % 3);
  }
  flush();
  EXPECT_EQ(hub(1).size() + hub(2).size(), 0u);
  ASSERT_NE(stream_, nullptr);
  EXPECT_FALSE(stream_->is_mirrored());
}

}  // namespace
}  // namespace eigencast::broker
