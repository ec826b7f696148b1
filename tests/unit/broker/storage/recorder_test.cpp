// SPDX-License-Identifier: MIT
#include "broker/storage/recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <list>
#include <mutex>

#include "broker/relay/hub.h"
#include "common/recording/reader.h"
#include "common/recording/writer.h"
#include "tests/support/process.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using ::eigencast::testing::eventually;
using testing::FakeAccount;
using testing::FakeSender;
using ::testing::HasSubstr;
using testing::key_number;
using testing::large_announce;
using testing::large_message;
using testing::segment_of;
using testing::small_announce;
using testing::small_layout;

class RecorderTest : public ::testing::Test {
 protected:
  RecorderTest() {
    settings_.folder = folder_.file("recordings");
    settings_.software = "test";
    assets_ = AssetStore::open(folder_.file("data"), {}).value();
  }
  void start() {
    recorder_ = std::make_unique<Recorder>(settings_, *assets_, [this](LogLevel, std::string_view line) {
      const std::lock_guard lock(log_mutex_);
      log_ += std::string(line) + "\n";
    });
    Stream::Settings settings;
    settings.taps = {assets_.get(), recorder_.get()};
    stream_ = std::make_unique<Stream>("lab/horse", 1, settings);
    ASSERT_TRUE(stream_->claim(sender_));
  }
  void announce() {
    control::Announce announce = small_announce();
    announce.asset = asset_;
    sender_.begin_anew();
    ASSERT_TRUE(stream_->announce(announce, ++epoch_));
    sender_.tag = stream_->tag();
  }
  void send(int keys) {
    for (int i = 0; i < keys; ++i, now_us_ += 33'000) ASSERT_TRUE(stream_->add_frame(sender_.next(now_us_), now_us_));
  }
  /// A stream of the hub, with a sender that has announced it.
  Stream& announce_as(Hub& hub, const std::string& name, const std::string& holder, std::size_t asset_bytes) {
    auto& sender = senders_.emplace_back();
    Stream& stream = *hub.open(name).value();
    EXPECT_TRUE(stream.claim(sender));
    EXPECT_TRUE(hub.admit(stream, {holder, false}, small_announce().format, FakeAccount().charge()));
    control::Announce announce = small_announce();
    announce.asset = put(Bytes(asset_bytes, static_cast<std::uint8_t>(name.size()))).hex();
    EXPECT_TRUE(stream.announce(announce, ++epoch_));
    return stream;
  }
  Sha256 put(const Bytes& bytes) {
    auto upload = assets_->begin_upload(sha256(bytes)).value();
    EXPECT_TRUE(upload->write(bytes));
    EXPECT_TRUE(upload->commit());
    return sha256(bytes);
  }
  void end() {
    stream_.reset();
    recorder_.reset();
  }
  std::string log() {
    const std::lock_guard lock(log_mutex_);
    return log_;
  }
  std::vector<std::string> files() const {
    std::vector<std::string> found;
    for (const auto& entry : std::filesystem::directory_iterator(settings_.folder))
      found.push_back(entry.path().string());
    return found;
  }
  /// The keys from where the reader stands. All that they need came before.
  static std::vector<Key> decode_recalled(recording::Reader& reader) {
    std::vector<Key> keys;
    std::map<Sha256, Bytes> objects;
    const auto offsets = reader.object_offsets().value();
    for (const std::uint64_t offset : offsets) {
      const Bytes body = reader.object_at(offset)->body;
      const Bytes bytes(body.begin() + recording::kIdBytes, body.end());
      objects[sha256(bytes)] = bytes;
    }
    std::optional<ChainState> state;
    PoseMemory memory(small_layout());
    EnvelopeReader frames;
    for (auto record = reader.next(); record && *record; record = reader.next()) {
      const auto& [type, time_us, body] = **record;
      if (type == recording::Type::kAnnounce) {
        state.reset();
        frames.restart();
        memory = PoseMemory(small_layout());
      }
      for (std::size_t at = 0; type == recording::Type::kMemory && at < body.size(); at += recording::kIdBytes) {
        Sha256 id;
        std::copy_n(body.begin() + static_cast<std::ptrdiff_t>(at), recording::kIdBytes, id.digest.begin());
        memory = memory.with(decode_segment(small_layout(), {}, objects.at(id)).value()).value();
      }
      if (type != recording::Type::kFrame && type != recording::Type::kCheckpoint) continue;
      const auto frame = frames.read(parse_frame(body).value()).value();
      const Envelope& head = frame.envelope;
      if (head.kind == FrameKind::kJoin) {
        auto join = decode_join(small_layout(), head.bands, frame.payload, head.is_recalled()).value();
        const bool known = state && state->newer == join.newer;
        state = std::move(join);
        if (known) continue;
      } else if (head.is_recalled()) {
        auto key = decode_recalled_key(small_layout(), head.bands, *state, memory, frame.payload).value();
        state = advanced(state, key.key, 0, key.phase);
      } else {
        state = advanced(state, decode_key(small_layout(), head.bands, *state, frame.payload).value(), 0);
      }
      keys.push_back(state->newer);
    }
    return keys;
  }
  /// The sequences of all keys that can be decoded from where the reader stands; each must be key_number(sequence).
  static std::vector<std::uint64_t> decode(recording::Reader& reader) {
    std::vector<std::uint64_t> sequences;
    std::optional<ChainState> state;
    EnvelopeReader frames;
    for (;;) {
      const auto record = reader.next();
      EXPECT_TRUE(record);
      if (!record || !*record) return sequences;
      if ((**record).type == recording::Type::kAnnounce) {
        state.reset();
        frames.restart();
      }
      if ((**record).type != recording::Type::kFrame && (**record).type != recording::Type::kCheckpoint) continue;
      const auto frame = frames.read(parse_frame((**record).body).value());
      EXPECT_TRUE(frame) << "it follows from the frame before it";
      if (!frame) return sequences;
      const Envelope& head = frame->envelope;
      if (head.kind == FrameKind::kJoin) {
        state = decode_join(small_layout(), head.bands, frame->payload).value();
      } else {
        EXPECT_TRUE(state);
        if (!state) return sequences;
        const auto key = decode_key(small_layout(), head.bands, *state, frame->payload);
        EXPECT_TRUE(key);
        state = advanced(state, *key, 33'000);
      }
      EXPECT_EQ(state->newer, key_number(static_cast<int>(head.sequence)));
      if (sequences.empty() || sequences.back() != head.sequence) sequences.push_back(head.sequence);
    }
  }

  ::eigencast::testing::TemporaryFolder folder_;
  Recorder::Settings settings_;
  std::unique_ptr<AssetStore> assets_;
  std::mutex log_mutex_;
  std::string log_;
  std::unique_ptr<Recorder> recorder_;
  std::unique_ptr<Stream> stream_;
  FakeSender sender_;
  std::list<FakeSender> senders_;
  std::string asset_ = std::string(64, 'a');
  std::uint32_t epoch_ = 0;
  TimeUs now_us_ = 1'000'000;
};

TEST_F(RecorderTest, RecordsEveryKeyWithCheckpoints) {
  start();
  announce();
  send(40);
  ASSERT_TRUE(recorder_->start("lab/horse"));
  EXPECT_EQ(recorder_->start("lab/horse").error().code, ErrorCode::kRefused);
  EXPECT_EQ(recorder_->list().at(0).state, RecordingInfo::State::kWaiting);
  send(100);
  ASSERT_TRUE(recorder_->stop("lab/horse"));
  EXPECT_EQ(recorder_->stop("lab/horse").error().code, ErrorCode::kNotFound);
  send(10);
  end();
  ASSERT_EQ(files().size(), 1u);
  EXPECT_THAT(files()[0], HasSubstr("/lab~horse."));
  auto reader = recording::Reader::open(files()[0]);
  ASSERT_TRUE(reader);
  EXPECT_TRUE(reader->info().complete);
  EXPECT_EQ(reader->info().start.stream, "lab/horse");
  EXPECT_EQ(reader->info().dropped, 0u);
  const auto all = decode(*reader);
  ASSERT_EQ(all.size(), 100u);
  EXPECT_EQ(all.front(), 40u);
  EXPECT_EQ(all.back(), 139u);
  EXPECT_GE(reader->index().size(), 3u);
  ASSERT_TRUE(reader->seek(2'000'000));
  const auto late = decode(*reader);
  EXPECT_GT(late.front(), 60u);
  EXPECT_EQ(late.back(), 139u);
}

TEST_F(RecorderTest, PatternsRecordEachSessionIntoItsFile) {
  settings_.streams = StreamPatterns::from(std::vector<std::string>{"lab/*"}).value();
  start();
  announce();
  send(20);
  announce();
  send(20);
  stream_->release(sender_);
  EXPECT_TRUE(eventually([&] {
    const auto list = recorder_->list();
    return !list.empty() && list.front().state == RecordingInfo::State::kFinished;
  }));
  ASSERT_TRUE(stream_->claim(sender_));
  announce();
  send(5);
  end();
  ASSERT_EQ(files().size(), 2u) << log();
  std::size_t keys = 0;
  for (const std::string& file : files()) {
    auto reader = recording::Reader::open(file);
    ASSERT_TRUE(reader);
    keys += decode(*reader).size();
  }
  EXPECT_EQ(keys, 45u);
}

TEST_F(RecorderTest, SlowDiskDropsAndBridgesFrames) {
  settings_.max_queued_bytes = 20'000;
  start();
  announce();
  ASSERT_TRUE(recorder_->start("lab/horse"));
  send(500);
  const std::uint64_t dropped = recorder_->totals().dropped;
  EXPECT_GT(dropped, 300u) << "the queue is bounded";
  ASSERT_TRUE(eventually([&] { return recorder_->totals().queued_bytes == 0; }));
  send(3);
  ASSERT_TRUE(recorder_->stop("lab/horse"));
  end();
  auto reader = recording::Reader::open(files().at(0));
  ASSERT_TRUE(reader);
  EXPECT_EQ(reader->info().dropped, dropped);
  const auto all = decode(*reader);
  EXPECT_EQ(all.size() + dropped, 503u) << "and all that was taken can be decoded";
}

TEST_F(RecorderTest, AMemoryIsThereBeforeWhatNeedsIt) {
  settings_.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
  start();
  auto hub = std::make_unique<Hub>(Hub::Settings{.stream = {.taps = {assets_.get(), recorder_.get()}}});
  Stream& stream = announce_as(*hub, "a", "camera", 10);
  FakeSender& sender = senders_.back();
  sender.tag = stream.tag();
  std::vector<Key> sent;
  const auto add = [&](const Bytes& message) {
    ASSERT_TRUE(stream.add_frame(message, now_us_));
    sent.push_back(sender.sent());
    now_us_ += 33'000;
  };
  const auto remember = [&](std::vector<Generation::Segment> before, int first) {
    before.push_back(segment_of(first, 20));
    ASSERT_TRUE(hub->remember(stream, std::move(before)));
  };
  const auto recall = [&](std::uint32_t from, std::uint32_t to) {
    for (std::uint32_t pose = from; pose < to; ++pose)
      add(sender.next_recalled(now_us_, stream.memory()->poses, 8 * pose));
  };
  for (int i = 0; i < 3; ++i) add(sender.next(now_us_));
  remember({}, 0);
  add(sender.next(now_us_));
  recall(2, 19);
  remember(stream.memory()->segments, 20);
  recall(5, 9);
  recall(22, 39);
  stream.set_memory(nullptr);
  sender.forget_phase();
  add(sender.next(now_us_));
  remember({}, 40);
  recall(1, 19);
  hub.reset();
  end();
  auto reader = recording::Reader::open(files().at(0));
  ASSERT_TRUE(reader);
  EXPECT_EQ(decode_recalled(*reader), sent);
  for (TimeUs at_us = 0; at_us < reader->info().duration_us; at_us += 200'000) {
    ASSERT_TRUE(reader->seek(at_us));
    const auto late = decode_recalled(*reader);
    EXPECT_TRUE(!late.empty() && std::equal(late.rbegin(), late.rend(), sent.rbegin())) << at_us;
  }
}

TEST_F(RecorderTest, QueueHoldsNoStatesOfLargeStreams) {
  start();
  ASSERT_TRUE(stream_->announce(large_announce(), ++epoch_));
  ASSERT_TRUE(recorder_->start("lab/horse"));
  std::vector<std::weak_ptr<const KeyRecord>> records;
  for (std::uint64_t i = 0; i < 300; ++i) {
    now_us_ += 1000;
    ASSERT_TRUE(stream_->add_frame(large_message(*stream_, i, now_us_), now_us_));
    records.push_back(stream_->snapshot().newest);
  }
  const auto held = std::count_if(records.begin(), records.end(), [](const auto& record) { return !record.expired(); });
  EXPECT_EQ(held, 1) << "the stream's own, with 262 kB of values";
  ASSERT_TRUE(recorder_->stop("lab/horse"));
  end();
  auto reader = recording::Reader::open(files().at(0));
  ASSERT_TRUE(reader);
  EXPECT_EQ(reader->info().frames, 299u) << "a checkpoint holds the first";
}

TEST_F(RecorderTest, QueueHasRoomForOthers) {
  settings_.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
  settings_.max_queued_bytes = 65'536;
  start();
  Hub hub({.stream = {.taps = {assets_.get(), recorder_.get()}}});
  std::vector<Stream*> streams;
  for (const char* name : {"greedy/1", "greedy/2", "good"})
    streams.push_back(&announce_as(hub, name, std::string(name) == "good" ? "camera" : "other", 10));
  const auto send_to = [&](std::size_t i) {
    ++now_us_;
    ASSERT_TRUE(streams[i]->add_frame(std::next(senders_.begin(), static_cast<int>(i))->next(now_us_), now_us_));
  };
  for (int i = 0; i < 20; ++i) {
    const std::uint64_t dropped = recorder_->totals().dropped;
    while (recorder_->totals().dropped == dropped) {
      send_to(0);
      send_to(1);
    }
    send_to(2);
  }
  for (const RecordingInfo& info : recorder_->list()) EXPECT_EQ(info.dropped > 0, info.stream != "good") << info.stream;
  EXPECT_GT(recorder_->totals().dropped, 19u);
}

TEST_F(RecorderTest, AnnouncementsCountTowardsTheQueue) {
  settings_.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
  settings_.max_queued_bytes = 100'000;
  start();
  for (int i = 0; i < 2000; ++i) {
    announce();
    ASSERT_LE(recorder_->totals().queued_bytes, settings_.max_queued_bytes);
  }
  ASSERT_TRUE(eventually([&] { return recorder_->totals().queued_bytes == 0; }));
  asset_ = std::string(64, 'b');
  announce();
  send(5);
  end();
  auto reader = recording::Reader::open(files().at(0));
  ASSERT_TRUE(reader);
  ASSERT_TRUE(reader->seek(reader->info().duration_us));
  const auto record = reader->next();
  ASSERT_TRUE(record && *record);
  const std::string last((**record).body.begin(), (**record).body.end());
  EXPECT_THAT(last, HasSubstr(asset_)) << "the surface of the keys is there";
  EXPECT_EQ(decode(*reader).back(), 4U);
}

TEST_F(RecorderTest, WhatIsLateAtTheEndIsLeftOutAndCounted) {
  start();
  announce();
  ASSERT_TRUE(recorder_->start("lab/horse"));
  send(5000);
  recorder_->end_by(0);
  end();
  std::size_t written = 0;
  for (const std::string& file : files()) {
    ASSERT_TRUE(recording::recover(file)) << "it ends with a whole record";
    auto reader = recording::Reader::open(file);
    ASSERT_TRUE(reader);
    written += decode(*reader).size();
  }
  const auto at = log().find(" frames are not in ");
  const std::string before = at == std::string::npos ? "\n0" : "\n" + log().substr(0, at);
  EXPECT_EQ(written + std::stoull(before.substr(before.rfind('\n') + 1)), 5000U) << log();
}

TEST_F(RecorderTest, AssetIsIncludedIfConfigured) {
  settings_.include_asset = true;
  const Sha256 chunk = put(Bytes(1000, 7));
  asset_ = put(testing::manifest_of({chunk})).hex();
  start();
  ASSERT_TRUE(recorder_->start("lab/horse"));
  announce();
  send(5);
  end();
  auto reader = recording::Reader::open(files().at(0));
  const auto objects = reader->object_offsets().value();
  ASSERT_EQ(objects.size(), 2u);
  const auto first = reader->object_at(objects[0]).value();
  EXPECT_EQ(Bytes(first.body.begin(), first.body.begin() + 32), Bytes(chunk.digest.begin(), chunk.digest.end()));
  EXPECT_EQ(sha256(ByteView(first.body).subspan(32)), chunk);
}

TEST_F(RecorderTest, AssetIsStoredOnceHoweverOftenAnnounced) {
  settings_.include_asset = true;
  const Sha256 chunk = put(Bytes(100'000, 7));
  const auto manifest = [&](std::uint8_t number) {
    return put(testing::manifest_of({chunk, sha256(Bytes{number})})).hex();
  };
  start();
  ASSERT_TRUE(recorder_->start("lab/horse"));
  for (int i = 0; i < 30; ++i) {
    asset_ = manifest(static_cast<std::uint8_t>(i % 3));
    announce();
    send(1);
  }
  end();
  const auto objects = recording::Reader::open(files().at(0))->object_offsets().value();
  EXPECT_EQ(objects.size(), 4u) << "three manifests and the chunk that they share";
  EXPECT_LT(std::filesystem::file_size(files()[0]), 150'000u);
}

TEST_F(RecorderTest, QuotaOfAHolderStopsOnlyItsOwn) {
  settings_.include_asset = true;
  settings_.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
  settings_.max_total_bytes = 2'000'000;
  start();
  Hub hub({.stream = {.taps = {assets_.get(), recorder_.get()}}});
  announce_as(hub, "good", "camera", 10'000);
  announce_as(hub, "greedy", "other", 600'000);
  const auto is_recording = [&](const std::string& name) {
    const auto list = recorder_->list();
    return std::any_of(list.begin(), list.end(), [&](const RecordingInfo& info) {
      return info.stream == name && info.state == RecordingInfo::State::kRecording;
    });
  };
  EXPECT_TRUE(eventually([&] { return is_recording("good") && recorder_->totals().active == 1; })) << log();
  EXPECT_FALSE(is_recording("greedy"));
  EXPECT_THAT(log(), HasSubstr("recording.max_total_bytes"));
  announce_as(hub, "greedy/again", "other", 10);
  EXPECT_EQ(recorder_->totals().active, 1u) << "no file anew for what is over its share";
  announce_as(hub, "third", "third", 10);
  EXPECT_EQ(recorder_->totals().active, 2u);
}

/// Whether senders are at another broker.
class RecorderHoldersTest : public RecorderTest, public ::testing::WithParamInterface<bool> {};
INSTANTIATE_TEST_SUITE_P(HereAndElsewhere, RecorderHoldersTest, ::testing::Bool());

TEST_P(RecorderHoldersTest, TwoHoldersLeaveRoomForOthers) {
  settings_.include_asset = true;
  settings_.streams = StreamPatterns::from(std::vector<std::string>{"**"}).value();
  settings_.max_total_bytes = 1'000'000;
  start();
  Hub hub({.stream = {.taps = {assets_.get(), recorder_.get()}}});
  std::map<std::string, Stream*> streams;
  std::uint8_t number = 0;
  const auto announce_for = [&](const std::string& holder, std::size_t asset_bytes) {
    Stream*& stream = streams[holder];
    if (stream == nullptr) {
      stream = hub.open("of/" + holder).value();
      EXPECT_TRUE(stream->claim(senders_.emplace_back()));
      const StreamFormat format = small_announce().format;
      EXPECT_TRUE(GetParam() ? hub.hold_keys(*stream, {holder}, format)
                             : hub.admit(*stream, {holder}, format, FakeAccount().charge()));
    }
    control::Announce announce = small_announce();
    announce.asset = put(Bytes(asset_bytes, ++number)).hex();
    EXPECT_TRUE(stream->announce(announce, ++epoch_));
  };
  announce_for("good", 1'000);
  for (int i = 0; i < 30; ++i) {
    for (const char* holder : {"first", "second"}) announce_for(holder, 20'000);
    EXPECT_TRUE(eventually([&] { return recorder_->totals().queued_bytes == 0; })) << log();
  }
  EXPECT_TRUE(eventually([&] { return recorder_->totals().active == 1; })) << "the good one: " << log();
  EXPECT_LT(recorder_->totals().stored_bytes, 600'000u);
}

TEST_F(RecorderTest, FullDiskEndsOnlyTheRecording) {
  start();
  announce();
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{3000, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  ASSERT_TRUE(recorder_->start("lab/horse"));
  send(200);
  EXPECT_TRUE(eventually([&] { return recorder_->totals().failed == 1; }));
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  EXPECT_EQ(recorder_->list().at(0).state, RecordingInfo::State::kFailed);
  EXPECT_FALSE(recorder_->list().at(0).error.empty());
  send(10);
  ASSERT_TRUE(recorder_->start("lab/horse")) << "again, where there is room";
  send(10);
  end();
  EXPECT_EQ(files().size(), 2u);
}

TEST_F(RecorderTest, QuotaStopsRecordings) {
  settings_.max_total_bytes = 2000;
  start();
  announce();
  ASSERT_TRUE(recorder_->start("lab/horse"));
  send(300);
  EXPECT_TRUE(eventually([&] { return recorder_->totals().active == 0; }));
  EXPECT_EQ(recorder_->start("lab/horse").error().code, ErrorCode::kTooLarge);
  EXPECT_THAT(log(), HasSubstr("max_total_bytes"));
}

TEST_F(RecorderTest, TornRecordingIsRepairedAtStart) {
  std::filesystem::create_directories(settings_.folder);
  const std::string path = settings_.folder + "/a.20260101T000000Z.ecrec";
  {
    auto writer = recording::Writer::create(path, {"a", "test", 0}).value();
    ASSERT_TRUE(writer.announce(0, "{}"));
    ASSERT_TRUE(writer.frame(5, Bytes(10, 1)));
    ASSERT_TRUE(writer.flush());
  }
  std::ofstream(path, std::ios::app) << "torn";
  start();
  ASSERT_TRUE(eventually([&] {
    const auto reader = recording::Reader::open(path);
    return reader && reader->info().complete;
  })) << log();
  EXPECT_EQ(recording::Reader::open(path)->info().frames, 1u);
  end();
}

}  // namespace
}  // namespace eigencast::broker
