// SPDX-License-Identifier: MIT
#include "broker/storage/history.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <random>
#include <utility>

#include "broker/relay/hub.h"
#include "broker/storage/past_reader.h"
#include "common/wire/limits.h"
#include "tests/support/process.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using ::eigencast::testing::eventually;
using testing::FakeSender;
using testing::key_number;
using testing::segment_of;
using testing::small_announce;
using testing::small_layout;

/// A stream whose poses came in the past, and what is kept of it.
class HistoryTest : public ::testing::Test {
 protected:
  static constexpr TimeUs kSecond = 1'000'000, kMinute = 60 * kSecond;
  static constexpr TimeUs kSendersClock = 60 * kMinute;  ///< Ahead: this machine may have started just now.

  HistoryTest() {
    settings_.folder = folder_.file("history");
    settings_.software = "test";
    settings_.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
    settings_.checkpoint_us = 5 * kSecond;
    settings_.keep_us = 60 * kMinute;
    assets_ = AssetStore::open(folder_.file("data"), {.min_idle_us = 0}).value();
  }
  /// Its first pose came so long ago.
  void start(TimeUs ago_us) {
    history_ = std::make_unique<History>(settings_, *assets_, LogSink());
    now_us_ = first_us_ = steady_now_us() - ago_us;
    Stream::Settings settings;
    settings.taps = {assets_.get(), history_->kept.get()};
    stream_ = std::make_unique<Stream>("lab/horse", 1, settings);
    ASSERT_TRUE(stream_->claim(sender_));
  }
  void announce(const std::string& asset = std::string(64, 'a')) {
    control::Announce announce = small_announce();
    announce.asset = asset;
    announce.utc_us = kUtcUs;
    sender_.begin_anew();
    ASSERT_TRUE(stream_->announce(announce, ++epoch_));
    sender_.tag = stream_->tag();
  }
  void send(int keys, TimeUs every_us = kSecond / 30) {
    for (int i = 0; i < keys; ++i, now_us_ += every_us)
      ASSERT_TRUE(stream_->add_frame(sender_.next(kSendersClock + now_us_), now_us_));
  }
  void stall() { stream_->release(sender_); }
  /// All that was sent is in files that have ended.
  void end() {
    stream_.reset();
    history_->kept.reset();
  }
  void restart() {
    end();
    history_ = std::make_unique<History>(settings_, *assets_, LogSink());
  }
  std::vector<Recorder::Piece> pieces() { return history_->kept->pieces("lab/horse"); }
  TimeUs at(TimeUs steady_us) const { return history_->kept->unix_from_steady(steady_us); }
  std::size_t files() const {
    std::size_t count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(settings_.folder)) count += entry.is_regular_file();
    return count;
  }
  std::string put(const Bytes& bytes) {
    auto upload = assets_->begin_upload(sha256(bytes)).value();
    EXPECT_TRUE(upload->write(bytes));
    EXPECT_TRUE(upload->commit());
    return sha256(bytes).hex();
  }
  /// "s0" of one holder in fifty files, and "s1" of another in two of the oldest.
  void two_holders() {
    history_ = std::make_unique<History>(settings_, *assets_, LogSink());
    Hub::Settings hub_settings;
    hub_settings.stream.taps = {history_->kept.get()};
    Hub hub(hub_settings);
    FakeSender senders[2];
    Stream* streams[2];
    testing::FakeAccount account;
    for (int i = 0; i < 2; ++i) {
      streams[i] = hub.open("s" + std::to_string(i)).value();
      ASSERT_TRUE(streams[i]->claim(senders[i]));
      ASSERT_TRUE(hub.admit(*streams[i], {"holder-" + std::to_string(i)}, small_announce().format, account.charge()));
      ASSERT_TRUE(streams[i]->announce(small_announce(), 1));
      senders[i].tag = streams[i]->tag();
    }
    TimeUs now_us = steady_now_us() - 55 * kMinute;
    for (int i = 0; i < 50 * 60; ++i, now_us += kSecond) {
      ASSERT_TRUE(streams[0]->add_frame(senders[0].next(kSendersClock + now_us), now_us));
      if (i >= 120) continue;
      ASSERT_TRUE(streams[1]->add_frame(senders[1].next(kSendersClock + now_us), now_us));
    }
    for (int i = 0; i < 2; ++i) streams[i]->release(senders[i]);
  }
  bool is_within_share() {
    const auto totals = history_->kept->totals();
    return totals.queued_bytes == 0 && totals.stored_bytes > 0 && !history_->kept->pieces("s0").empty() &&
           history_->kept->pieces("s0").size() * 65'536 <= settings_.max_total_bytes / 4;
  }
  static void expect_pose(const Passage::Pose& pose, std::uint64_t sequence) {
    EXPECT_EQ(pose.key->sequence, sequence);
    EXPECT_EQ(pose.key->generation, 0U);
    EXPECT_EQ(pose.key->after->newer.q, key_number(static_cast<int>(sequence)).q);
  }

  ::eigencast::testing::TemporaryFolder folder_;
  Recorder::Settings settings_;
  std::unique_ptr<AssetStore> assets_;
  std::unique_ptr<History> history_;
  std::unique_ptr<Stream> stream_;
  FakeSender sender_;
  const PosesCharge free_ = [](auto segment) { return Result(std::move(segment)); };
  static constexpr TimeUs kUtcUs = 1'800'000'000'000'000 - kSendersClock;
  std::uint32_t epoch_ = 0;
  TimeUs first_us_ = 0, now_us_ = 0;
};

TEST_F(HistoryTest, EveryMomentIsFoundAndPlaysOnFromFileToFile) {
  constexpr int kKeys = 4500;  // 150 s: three files.
  constexpr TimeUs kEvery = kSecond / 30;
  start(151 * kSecond);
  announce();
  send(kKeys);
  const auto end_us = now_us_ - kEvery;
  ASSERT_TRUE(eventually([&] { return pieces().size() == 3 && pieces().back().to_us >= at(end_us); }));
  std::mt19937 random(1);
  PastReader reader(*history_->kept, "lab/horse", free_);
  for (int i = 0; i < 60; ++i) {
    const auto sequence = std::uniform_int_distribution<std::uint64_t>(0, kKeys - 2)(random);
    const TimeUs at_us = at(first_us_ + static_cast<TimeUs>(sequence) * kEvery);
    const bool next = i % 3 == 2;
    const auto found = reader.seek({"lab/horse", at_us + (next ? 0 : i % 2), next, 0.5}, 1000);
    ASSERT_TRUE(found) << found.error().message;
    ASSERT_EQ(found->poses.size(), 1U);
    ASSERT_TRUE(found->begins);
    EXPECT_EQ(found->begins->announced.asset, small_announce().asset);
    EXPECT_EQ(found->begins->rewind.at_us, at_us + (next ? kEvery : 0));
    EXPECT_EQ(found->begins->rewind.capture_us, found->poses[0].key->capture_us);
    expect_pose(found->poses[0], sequence + (next ? 1 : 0));
  }
  // Across the borders of files the chain goes on, and times of capture go at half the speed.
  const auto found = reader.seek({"lab/horse", at(first_us_), false, 0.5}, 1000);
  ASSERT_TRUE(found);
  KeyRecordPtr last = found->poses[0].key;
  control::StreamInfo past;
  past.utc_us = found->begins->announced.utc_us;
  past.rewind = found->begins->rewind;
  const auto live_timecode = [&](std::uint64_t sequence) {
    return kUtcUs + kSendersClock + first_us_ + static_cast<TimeUs>(sequence) * kEvery;
  };
  EXPECT_EQ(utc_of(past, last->capture_us), live_timecode(0));
  while (last->sequence + 1 < kKeys) {
    const auto more = reader.go_on(at(end_us) + kMinute);
    ASSERT_TRUE(more) << more.error().message;
    EXPECT_FALSE(more->begins);
    ASSERT_FALSE(more->poses.empty()) << last->sequence;
    for (const auto& pose : more->poses) {
      expect_pose(pose, last->sequence + 1);
      EXPECT_EQ(pose.key->before, last->after);
      EXPECT_EQ(pose.key->after->age_us, pose.key->capture_us - last->capture_us);
      EXPECT_NEAR(static_cast<double>(pose.key->capture_us - last->capture_us), 2.0 * kEvery, 2);
      last = pose.key;
      EXPECT_NEAR(static_cast<double>(utc_of(past, last->capture_us) - live_timecode(last->sequence)), 0, 1);
    }
  }
}

TEST_F(HistoryTest, WhatIsStillBeingWrittenIsReadOn) {
  start(5 * kSecond);
  announce();
  send(10);
  PastReader reader(*history_->kept, "lab/horse", free_);
  std::optional<Passage> found;
  ASSERT_TRUE(eventually([&] {
    auto passage = reader.seek({"lab/horse", at(now_us_), false, 0}, 1);
    if (passage && !passage->poses.empty() && passage->poses[0].key->sequence == 9) found = *std::move(passage);
    return found.has_value();
  }));
  send(10);
  std::uint64_t newest = 9;
  ASSERT_TRUE(eventually([&] {
    const auto more = reader.go_on(at(now_us_));
    EXPECT_TRUE(more);
    for (const auto& pose : more->poses) expect_pose(pose, ++newest);
    EXPECT_FALSE(more->ends);
    return newest == 19;
  }));
  stall();
  ASSERT_TRUE(eventually([&] { return reader.go_on(at(now_us_))->ends; }));
}

TEST_F(HistoryTest, ManyKeysHaveACheckpointToo) {
  settings_.checkpoint_keys = 10;
  start(10 * kSecond);
  announce();
  send(95, kSecond / 1000);
  end();
  int checkpoints = 0;
  for (const auto& file : std::filesystem::directory_iterator(settings_.folder)) {
    auto reader = recording::Reader::open(file.path());
    ASSERT_TRUE(reader) << reader.error().message;
    for (;;) {
      const auto record = reader->next();
      ASSERT_TRUE(record);
      if (!*record) break;
      checkpoints += (*record)->type == recording::Type::kCheckpoint ? 1 : 0;
    }
  }
  EXPECT_EQ(checkpoints, 10);
}

TEST_F(HistoryTest, GapsAreLeftOutAndAnotherAssetBeginsAnew) {
  start(100 * kSecond);
  announce();
  send(30);
  const TimeUs first_end_us = now_us_ - kSecond / 30;
  stall();
  now_us_ += 60 * kSecond;
  ASSERT_TRUE(stream_->claim(sender_));
  const std::string other(64, 'b');
  announce(other);
  send(30);
  ASSERT_TRUE(eventually([&] { return pieces().size() == 2 && pieces().back().to_us >= at(now_us_ - kSecond / 30); }));
  const auto told = history_->of("lab/horse", steady_now_us());
  ASSERT_EQ(told.spans.size(), 2U);
  EXPECT_EQ(told.spans[0], (control::History::Span{at(first_us_), at(first_end_us)}));
  EXPECT_EQ(told.spans[1].from_us, at(first_end_us + kSecond / 30 + 60 * kSecond));
  EXPECT_EQ(told.spans[1].to_us, told.now_us);

  PastReader reader(*history_->kept, "lab/horse", free_);
  const auto in_gap = reader.seek({"lab/horse", at(first_end_us + 30 * kSecond), false, 0}, 1);
  ASSERT_TRUE(in_gap);
  expect_pose(in_gap->poses[0], 30);
  EXPECT_EQ(in_gap->begins->announced.asset, other);
  const auto before_all = reader.seek({"lab/horse", 0, false, 1}, 1);
  ASSERT_TRUE(before_all);
  expect_pose(before_all->poses[0], 0);
  const auto rest = reader.go_on(at(first_us_) + kMinute);
  ASSERT_TRUE(rest);
  ASSERT_EQ(rest->poses.size(), 29U);
  EXPECT_FALSE(rest->begins);
  const auto after = reader.go_on(at(first_us_) + kMinute);
  ASSERT_TRUE(after);
  ASSERT_TRUE(after->begins);
  EXPECT_EQ(after->begins->announced.asset, other);
  EXPECT_GT(after->begins->rewind.capture_us, rest->poses.back().key->capture_us);
  expect_pose(after->poses.at(0), 30);
}

TEST_F(HistoryTest, WhatIsOfThePresentOrOfNothingIsNotSought) {
  start(10 * kSecond);
  PastReader reader(*history_->kept, "lab/horse", free_);
  EXPECT_EQ(reader.seek({"lab/horse", 1, false, 1}, 1).error().code, ErrorCode::kNotFound);
  announce();
  send(30);
  ASSERT_TRUE(eventually([&] { return reader.seek({"lab/horse", at(first_us_), false, 1}, 1).has_value(); }));
  const auto live = [&](TimeUs at_us, double speed) {
    const auto found = reader.seek({"lab/horse", at_us, false, speed}, 1);
    return found && found->ends && found->poses.empty();
  };
  EXPECT_TRUE(live(limits::kMaxTimeUs, 1));
  EXPECT_TRUE(live(at(steady_now_us()), 2));
  EXPECT_FALSE(live(limits::kMaxTimeUs, 0)) << "it may be stopped at the newest pose";
  stall();
  ASSERT_TRUE(eventually([&] { return !pieces().back().growing; }));
  EXPECT_TRUE(live(limits::kMaxTimeUs, 0));
}

TEST_F(HistoryTest, TheOldestGoByAgeAndByBytes) {
  settings_.keep_us = 2 * kMinute;
  start(6 * kMinute);
  announce();
  send(5 * 60 * 10, kSecond / 10);
  ASSERT_TRUE(eventually([&] {
    const auto kept = pieces();
    return !kept.empty() && kept.back().to_us >= at(now_us_ - kSecond) &&
           kept.front().to_us >= at(steady_now_us()) - settings_.keep_us - kSecond && files() == kept.size();
  }));
  end();
  settings_.folder = folder_.file("other");
  settings_.keep_us = 60 * kMinute;
  settings_.max_total_bytes = 1 << 20;  // Files count 64 KiB at least.
  start(40 * kMinute);
  announce();
  send(20 * 60 * 3, kSecond / 3);
  ASSERT_TRUE(eventually([&] {
    return history_->kept->totals().queued_bytes == 0 &&
           history_->kept->totals().stored_bytes <= settings_.max_total_bytes && files() == pieces().size() &&
           pieces().back().to_us >= at(now_us_ - kSecond);
  }));
  EXPECT_LE(files(), 16U);
  EXPECT_GE(files(), 10U);
}

TEST_F(HistoryTest, WhoIsPausedLongGivesWayOnceForEachRefusal) {
  start(kSecond);
  EXPECT_FALSE(history_->give_way(History::kLongPauseUs)) << "nobody waits";
  history_->note_refused();
  EXPECT_FALSE(history_->give_way(History::kLongPauseUs - 1));
  EXPECT_TRUE(history_->give_way(History::kLongPauseUs));
  EXPECT_FALSE(history_->give_way(History::kLongPauseUs));
}

TEST_F(HistoryTest, WhatBeginsInTheFutureStaysWhileThereIsRoom) {
  start(-10 * kMinute);
  announce();
  send(30);
  restart();
  ASSERT_TRUE(eventually([&] { return history_->kept->totals().stored_bytes > 0; }));
  EXPECT_TRUE(pieces().empty());
  restart();  // Nothing is done once more when it ends.
  end();
  EXPECT_EQ(files(), 1U);
  settings_.max_total_bytes = 64 << 10;
  history_ = std::make_unique<History>(settings_, *assets_, LogSink());
  EXPECT_TRUE(eventually([&] { return files() == 0; }));
}

TEST_F(HistoryTest, ASenderThatBeginsAgainAndAgainLeavesFewFiles) {
  settings_.keep_us = 2 * kMinute;
  start(kMinute);
  const auto first = at(first_us_);
  // So many at a time, as only a hundred files of a second have names.
  for (int i = 0; i < 200 && (pieces().empty() || pieces().front().from_us <= first); ++i) {
    for (int k = 0; k < 50; ++k) {
      announce();
      send(1, 1000);
    }
    ASSERT_TRUE(eventually([&] { return history_->kept->totals().queued_bytes == 0; }));
  }
  stall();
  ASSERT_TRUE(eventually([&] { return pieces().size() <= 258; }));
  EXPECT_GT(pieces().front().from_us, first);
  EXPECT_GE(pieces().size(), 250U);
  double work_us = 0;
  (void)history_->of("lab/horse", now_us_, &work_us);
  EXPECT_GE(work_us, 0.1 * 250) << "who asks pays for what is looked at";
}

TEST_F(HistoryTest, AnnouncementsAgainAndAgainBeginFewFilesASecond) {
  start(kMinute);
  for (int i = 0; i < 3000; ++i) {  // Two seconds, as the stream knows them.
    announce();
    if (i % 3 > 0) send(1, 1000);
  }
  const auto stormy_us = now_us_;
  ASSERT_TRUE(eventually([&] { return history_->kept->totals().queued_bytes == 0; }));
  EXPECT_LE(files(), 3 * 256U);
  EXPECT_EQ(history_->kept->totals().failed, 0U) << "each has found a name";
  EXPECT_GT(history_->kept->totals().dropped, 1000U) << "and what was left out is counted";
  now_us_ += kSecond;
  send(30);
  ASSERT_TRUE(eventually([&] { return pieces().back().to_us >= at(now_us_ - kSecond / 30); })) << "then it goes on";
  PastReader reader(*history_->kept, "lab/horse", free_);
  const auto found = reader.seek({"lab/horse", at(stormy_us + kSecond), false, 0}, 1);
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_EQ(found->poses.size(), 1U);
}

TEST_F(HistoryTest, AHolderBeyondItsShareLosesItsOwn) {
  settings_.max_total_bytes = 2 << 20;
  two_holders();
  ASSERT_TRUE(eventually([&] { return is_within_share(); }));
  EXPECT_GE(history_->kept->pieces("s1").size(), 2U);
}

TEST_F(HistoryTest, AHolderBeyondItsShareLosesItsOwnAfterARestart) {
  two_holders();
  settings_.max_total_bytes = 2 << 20;
  restart();
  ASSERT_TRUE(eventually([&] { return is_within_share(); }));
  EXPECT_GE(history_->kept->pieces("s1").size(), 2U);
}

TEST_F(HistoryTest, AKilledRecorderLeavesAllButTheEnd) {
  start(3 * kMinute);
  announce();
  send(30 * 100);
  ASSERT_TRUE(eventually([&] { return pieces().size() == 2 && pieces().back().to_us >= at(now_us_ - kSecond / 30); }));
  const TimeUs first_at_us = at(first_us_);
  // As kill -9 leaves it: the file that was being written has no end, and a torn record.
  const std::string copy = folder_.file("copy");
  std::filesystem::copy(settings_.folder, copy);
  const std::string torn = copy + std::string("/") + std::filesystem::path(pieces().back().file).filename().string();
  std::ofstream(torn, std::ios::app | std::ios::binary) << std::string(40, '\x01');
  std::ofstream(copy + std::string("/lab~horse.20200101T000000Z.ecrec")) << "no recording";
  end();
  std::filesystem::remove_all(settings_.folder);
  std::filesystem::rename(copy, settings_.folder);
  restart();
  ASSERT_TRUE(eventually([&] { return pieces().size() == 2 && files() == 2; })) << "what cannot be read is removed";
  PastReader reader(*history_->kept, "lab/horse", free_);
  const auto first = reader.seek({"lab/horse", first_at_us, false, 0}, 1);
  ASSERT_TRUE(first);
  expect_pose(first->poses[0], 0);
  const auto last = reader.seek({"lab/horse", pieces().back().to_us, false, 0}, 1);
  ASSERT_TRUE(last);
  expect_pose(last->poses[0], 2999);
}

TEST_F(HistoryTest, KeysOfAMemoryAreSeenWithoutIt) {
  start(100 * kSecond);
  announce();
  const auto segment = segment_of(0, 200, Sha256::from_hex(small_announce().asset)->digest);
  PoseMemory memory(small_layout());
  ASSERT_TRUE(memory.add(segment.poses));
  auto known = segment;
  known.since = 1;
  send(3);
  stream_->set_memory(std::make_shared<const Generation>(Generation{1, 1, memory, {known}}));
  std::vector<Key> sent;
  for (std::uint32_t i = 3; i < 60 * 30; ++i, now_us_ += kSecond / 20) {
    const std::uint32_t phase = PoseMemory::kParts * (i % 150);
    ASSERT_TRUE(stream_->add_frame(sender_.next_recalled(kSendersClock + now_us_, memory, phase), now_us_));
    sent.push_back(sender_.sent());
  }
  ASSERT_TRUE(eventually([&] { return pieces().size() >= 2 && pieces().back().to_us >= at(now_us_ - kSecond / 20); }));
  const auto poses = std::make_shared<StreamMemory>();
  Hub small({.stream = {.max_memory_bytes = 200, .memory = poses}}), hub({.stream = {.memory = poses}});
  PastReader poor(*history_->kept, "lab/horse", small.poses_charge("viewer"));
  EXPECT_EQ(poor.seek({"lab/horse", at(first_us_ + 40 * kSecond), false, 1}, 1).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(poses->poses.used(), 0);
  std::optional<PastReader> held(std::in_place, *history_->kept, "lab/horse", hub.poses_charge("viewer"));
  PastReader& reader = *held;
  for (const int second : {1, 30, 61, 80}) {
    const auto found = reader.seek({"lab/horse", at(first_us_ + second * kSecond), false, 1}, 1);
    ASSERT_TRUE(found) << found.error().message;
    const auto more = reader.go_on(at(first_us_ + (second + 2) * kSecond));
    ASSERT_TRUE(more) << more.error().message;
    ASSERT_GE(more->poses.size(), 30U);
    for (const auto& pose : more->poses) {
      EXPECT_EQ(pose.key->generation, 0U);
      EXPECT_FALSE(pose.key->after->phase);
      const Key& was = sent.at(pose.key->sequence - 3);
      for (std::size_t i = 0; i < was.q.size(); ++i)
        ASSERT_NEAR(pose.key->after->newer.q[i], was.q[i], 8) << pose.key->sequence;
    }
  }
  EXPECT_GE(poses->poses.held("viewer"), std::ssize(segment.poses->values) * 4);
  held.reset();
  EXPECT_EQ(poses->poses.used(), 0);
}

TEST_F(HistoryTest, GoesOnOnceTheDiskTakesFilesAgain) {
  settings_.retry_us = 1;
  std::ofstream(settings_.folder) << "no folder";
  start(kSecond);
  announce();
  ASSERT_TRUE(eventually([&] {
    send(1, 1000);
    return history_->kept->totals().failed >= 2;
  })) << "it is tried again";
  EXPECT_EQ(history_->kept->totals().failing, 1U);
  EXPECT_TRUE(pieces().empty());
  std::filesystem::remove(settings_.folder);
  ASSERT_TRUE(eventually([&] {
    send(1, 1000);
    return history_->kept->totals().failing == 0;
  }));
  EXPECT_EQ(pieces().size(), 1U);
}

TEST_F(HistoryTest, AssetsStayWithTheirPast) {
  AssetStore::Settings small;
  small.max_objects = 5;
  small.min_idle_us = 0;
  assets_ = AssetStore::open(folder_.file("small"), small).value();
  const Sha256 idle = *Sha256::from_hex(put(Bytes(1000, 3)));
  const Sha256 chunk = *Sha256::from_hex(put(Bytes(1000, 7)));
  const Sha256 asset = *Sha256::from_hex(put(testing::manifest_of({chunk})));
  start(50 * kSecond);
  announce(asset.hex());
  send(30);
  ASSERT_TRUE(eventually([&] { return pieces().size() == 1 && pieces().back().to_us > pieces().back().from_us; }));
  announce(put(Bytes(10, 1)));
  for (std::uint8_t i = 0; i < 4; ++i) {
    assets_->note_uses();
    put(Bytes(20, i));
  }
  EXPECT_FALSE(assets_->contains(idle));
  EXPECT_TRUE(assets_->contains(asset));
  EXPECT_TRUE(assets_->contains(chunk));
  end();
}

TEST_F(HistoryTest, WithoutStreamsNothingIsKeptAnyMore) {
  start(10 * kSecond);
  announce();
  send(30);
  end();
  ASSERT_GE(files(), 1U);
  settings_.streams = {};
  const History none(settings_, *assets_, {});
  EXPECT_FALSE(std::filesystem::exists(settings_.folder));
  EXPECT_FALSE(none.keeps("lab/horse"));
  EXPECT_TRUE(none.of("lab/horse", 1).spans.empty());
}

}  // namespace
}  // namespace eigencast::broker
