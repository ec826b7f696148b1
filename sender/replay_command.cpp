// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "common/codec/chain.h"
#include "common/codec/pose_memory.h"
#include "common/core/hash/sha256.h"
#include "common/recording/reader.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "common/wire/limits.h"
#include "sdk/asset_folder.h"
#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/live.h"

namespace eigencast {
namespace {

using recording::Record;
using recording::Type;

constexpr TimeUs kPollUs = 100'000;
/// Longer pauses of the recording are cut to this.
constexpr TimeUs kLongestPauseUs = 5'000'000;

bool is_segment(ByteView object) {
  return object.size() > kSegmentMagic.size() && std::equal(kSegmentMagic.begin(), kSegmentMagic.end(), object.begin());
}

struct Pose {
  Key key;
  Bytes coded;                         ///< As a key of its chain; empty: it was a join.
  std::optional<std::uint32_t> phase;  ///< Where in the memory it was predicted from, if it was.
  TimeUs time_us = 0;                  ///< Runs with the recording.
};

/// So that playing can begin anywhere.
class ChainFollower {
 public:
  void begin(CoefficientLayout layout) {
    layout_ = std::move(layout);
    memory_.reset();
    state_.reset();
    reader_.restart();
  }
  void remember(PoseMemory memory) { memory_ = std::move(memory); }
  /// Nothing: not a new pose. Errors: kCorrupt.
  Result<std::optional<Pose>> follow(const Record& record) {
    const auto parsed = parse_frame(record.body);
    if (!parsed) return parsed.error();
    const auto frame = reader_.read(*parsed);
    if (!frame) return std::optional<Pose>();  // Behind a gap: the checkpoint that bridges it comes.
    const Envelope& head = frame->envelope;
    if (head.is_recalled() && !memory_)
      return fail(ErrorCode::kCorrupt, "a key is predicted from a memory that the recording does not have");
    if (head.kind == FrameKind::kJoin) {
      auto state = decode_join(layout_, head.bands, frame->payload, head.is_recalled());
      if (!state) return state.error();
      if (state->phase && !memory_->has(*state->phase))
        return fail(ErrorCode::kCorrupt, "a checkpoint has a phase that its memory does not have");
      const bool known = state_ && head.sequence == sequence_;
      state_ = std::move(*state);
      if (known) return std::optional<Pose>();
      sequence_ = head.sequence;
      return std::optional(Pose{state_->newer, {}, {}, record.time_us});
    }
    if (head.kind == FrameKind::kKey && state_) {
      auto next = decoded(*frame);
      if (!next) return next.error();
      state_ = std::move(*next);
      sequence_ = head.sequence;
      return std::optional(
          Pose{state_->newer, Bytes(frame->payload.begin(), frame->payload.end()), state_->phase, record.time_us});
    }
    return std::optional<Pose>();
  }

 private:
  /// REQUIRES: there is a state, and a memory where the frame needs one.
  Result<ChainState> decoded(const FrameView& frame) const {
    const BandMask bands = frame.envelope.bands;
    if (!frame.envelope.is_recalled()) {
      auto key = decode_key(layout_, bands, *state_, frame.payload);
      if (!key) return key.error();
      return advanced(state_, std::move(*key), 0);
    }
    auto recalled = decode_recalled_key(layout_, bands, *state_, *memory_, frame.payload);
    if (!recalled) return recalled.error();
    return advanced(state_, std::move(recalled->key), 0, recalled->phase);
  }

  CoefficientLayout layout_;
  EnvelopeReader reader_;
  std::optional<PoseMemory> memory_;
  std::optional<ChainState> state_;
  std::uint64_t sequence_ = 0;
};

class Replayer {
 public:
  Replayer(const ReplayCommand& command, recording::Reader reader) : command_(command), reader_(std::move(reader)) {}

  Result<void> run(Interrupt& interrupt) {
    if (auto gathered = gather_objects(); !gathered) return gathered;
    do {
      if (auto sought = reader_.seek(static_cast<TimeUs>(command_.from_s * 1e6)); !sought) return sought;
      const std::uint64_t before = sent_;
      const auto played = play_once(interrupt);
      if (!played) return played.error();
      if (!*played) return {};
      if (sent_ == before) return fail(ErrorCode::kInvalidArgument, "the recording has no pose there");
    } while (command_.loop);
    // What was sent last is still on its way.
    interrupt.wait_until(steady_now_us() + 300'000);
    return {};
  }

  nlohmann::json report() const {
    return {{"frames_sent", sent_},
            {"frames_dropped", dropped_},
            {"duration_s", reader_.info().duration_us * 1e-6},
            {"complete", reader_.info().complete}};
  }

 private:
  /// False: interrupted.
  Result<bool> play_once(Interrupt& interrupt) {
    const auto from_us = static_cast<TimeUs>(command_.from_s * 1e6);
    const TimeUs until_us =
        command_.duration_s > 0 ? from_us + static_cast<TimeUs>(command_.duration_s * 1e6) : reader_.info().duration_us;
    std::optional<TimeUs> last_us;
    std::optional<Pose> held;  // The latest pose before the beginning: what was to be seen then.
    for (;;) {
      auto record = reader_.next();
      if (!record) return record.error();
      if (!*record || (**record).time_us > until_us) return true;
      if ((**record).type == Type::kAnnounce) {
        if (auto begun = begin(**record); !begun) return begun.error();
      }
      if ((**record).type == Type::kMemory) {
        if (auto remembered = remember(**record); !remembered) return in_context(command_.file, remembered.error());
      }
      if ((**record).type != Type::kFrame && (**record).type != Type::kCheckpoint) continue;
      auto pose = chain_.follow(**record);
      if (!pose) return in_context(command_.file, pose.error());
      if (!*pose) continue;
      if ((**pose).time_us < from_us) {
        held = std::move(**pose);
        continue;
      }
      if (!publisher_) {
        const auto live = go_live(interrupt);
        if (!live) return live.error();
        if (!*live) return false;
      }
      if (held) {
        held->time_us = from_us;
        if (!send(std::move(*std::exchange(held, std::nullopt)), last_us, interrupt)) return false;
      }
      if (!send(std::move(**pose), last_us, interrupt)) return false;
      if (const auto ours = check_ownership(*publisher_); !ours) return ours.error();
    }
  }

  bool send(Pose pose, std::optional<TimeUs>& last_us, Interrupt& interrupt) {
    const TimeUs now_us = steady_now_us();
    if (last_us) {
      const TimeUs pause_us = std::min(pose.time_us - *last_us, kLongestPauseUs);
      due_us_ += static_cast<TimeUs>(std::llround(static_cast<double>(pause_us) / command_.speed));
    } else {
      due_us_ = std::max(due_us_ + 1, now_us);
    }
    last_us = pose.time_us;
    if (interrupt.wait_until(due_us_)) return false;
    // Even when the recording's arrivals came in a burst, captures grow.
    capture_us_ = std::max(capture_us_ + 1, due_us_);
    // Until the broker has the memory keys are coded exactly, as any that need none.
    if (!to_remember_.empty() && !publisher_->memory().pending)
      (void)publisher_->remember(std::exchange(to_remember_, {}));
    const SendStatus sent = publisher_->send_key(std::move(pose.key), capture_us_, pose.coded, pose.phase);
    sent == SendStatus::kSent ? ++sent_ : ++dropped_;
    return true;
  }

  Result<void> begin(const Record& record) {
    const auto message =
        control_from_text(std::string_view(reinterpret_cast<const char*>(record.body.data()), record.body.size()));
    if (!message) return in_context("the recorded announcement", message.error());
    const auto* announce = std::get_if<control::Announce>(&*message);
    if (announce == nullptr) return fail(ErrorCode::kCorrupt, "the recorded announcement is none");
    if (auto usable = check_format(announce->format); !usable) return usable;
    const auto codec = codec_from_name(announce->format.codec);
    if (!codec) return codec.error();
    const bool same = announced_ && publisher_ && announced_->asset == announce->asset &&
                      announced_->format == announce->format && announced_->world == announce->world;
    announced_ = *announce;
    layout_ = {*codec, announce->format.rows, announce->format.channels, announce->format.band_ends};
    chain_.begin(layout_);
    if (!same) publisher_.reset();  // Another epoch begins with the next pose.
    return {};
  }

  /// The poses that later keys are predicted from. Errors: kCorrupt, those of decode_segment.
  Result<void> remember(const Record& record) {
    const auto asset = announced_ ? Sha256::from_hex(announced_->asset) : std::nullopt;
    if (!asset || layout_.is_float() || record.body.size() % recording::kIdBytes != 0)
      return fail(ErrorCode::kCorrupt, "a memory without an announcement that it fits");
    PoseMemory memory(layout_);
    to_remember_.clear();
    for (ByteView ids = record.body; !ids.empty(); ids = ids.subspan(recording::kIdBytes)) {
      Sha256 id;
      std::copy_n(ids.begin(), recording::kIdBytes, id.digest.begin());
      const auto object = objects_.find(id);
      if (object == objects_.end())
        return fail(ErrorCode::kCorrupt, "the recording lacks segment " + id.hex() + " of a memory");
      auto segment = decode_segment(layout_, asset->digest, object->second);
      if (!segment) return segment.error();
      auto grown = memory.with(*segment);
      if (!grown) return grown.error();
      memory = *std::move(grown);
      to_remember_.push_back({object->second, *std::move(segment)});
    }
    chain_.remember(std::move(memory));
    return {};
  }

  Result<bool> go_live(Interrupt& interrupt) {
    if (!announced_) return fail(ErrorCode::kCorrupt, "the recording has poses before any announcement");
    const auto id = Sha256::from_hex(announced_->asset);
    if (!id) return fail(ErrorCode::kCorrupt, "the recorded announcement names no asset");
    auto encoded = std::make_shared<EncodedAsset>();
    encoded->manifest.id = *id;
    if (const auto manifest = objects_.find(*id); manifest != objects_.end()) {
      encoded->manifest.bytes = manifest->second;
      for (const auto& [other, bytes] : objects_) {
        if (other != *id && !is_segment(bytes)) encoded->chunks.push_back({other, bytes});
      }
    }
    PublisherOptions options;
    options.url = command_.target.url;
    options.credentials = command_.target.credentials;
    options.key_rate_hz = announced_->key_rate_hz * command_.speed;
    options.world = announced_->world;
    StreamFormat format = announced_->format;  // Velocities of a faster motion are so much larger.
    const double velocity_us = static_cast<double>(format.velocity_us) / command_.speed;
    format.velocity_us =
        static_cast<std::uint32_t>(std::clamp(std::round(velocity_us), 1.0, double{limits::kMaxVelocityUs}));
    auto made = Publisher::create_for_keys(options, format, std::move(encoded), to_log());
    if (const auto good = store(publisher_, std::move(made)); !good) return good.error();
    while (!wait_until_live(*publisher_, steady_now_us() + kPollUs, interrupt)) {
      if (interrupt.requested()) return false;
      if (const auto ours = check_ownership(*publisher_); !ours) return ours.error();
    }
    due_us_ = std::max(due_us_, steady_now_us());
    return true;
  }

  Result<void> gather_objects() {
    const auto offsets = reader_.object_offsets();
    if (!offsets) return offsets.error();
    for (const std::uint64_t offset : *offsets) {
      const auto object = reader_.object_at(offset);
      if (!object) return object.error();
      const ByteView bytes = ByteView(object->body).subspan(recording::kIdBytes);
      objects_.emplace(sha256(bytes), Bytes(bytes.begin(), bytes.end()));
    }
    if (command_.asset_dir.empty()) return {};
    std::error_code error;
    for (std::filesystem::directory_iterator it(command_.asset_dir, error), end; !error && it != end;
         it.increment(error)) {
      const auto id = Sha256::from_hex(it->path().filename().string());
      if (!id) continue;
      auto bytes = read_object(command_.asset_dir, *id);
      if (!bytes) return bytes.error();
      if (sha256(*bytes) != *id)
        return fail(ErrorCode::kCorrupt, it->path().string() + ": its content has another hash");
      objects_.emplace(*id, std::move(*bytes));
    }
    if (error) return fail(ErrorCode::kIo, command_.asset_dir + ": " + error.message());
    return {};
  }

  const ReplayCommand& command_;
  recording::Reader reader_;
  std::map<Sha256, Bytes> objects_;
  std::optional<control::Announce> announced_;
  CoefficientLayout layout_;
  ChainFollower chain_;
  std::vector<CodedSegment> to_remember_;  ///< By the publisher, as soon as it may.
  std::unique_ptr<Publisher> publisher_;
  TimeUs due_us_ = 0;
  TimeUs capture_us_ = 0;
  std::uint64_t sent_ = 0;
  std::uint64_t dropped_ = 0;
};

}  // namespace

int run(const ReplayCommand& command, const Console&, Interrupt& interrupt) {
  auto reader = recording::Reader::open(command.file);
  if (!reader) return report_failure(reader.error());
  if (const ExitCode usable = check_target(command.target); usable != kExitOk) return usable;
  const recording::Info& info = reader->info();
  spdlog::info("{}: stream '{}', {:.1f} s, {} frames{}", command.file, info.start.stream,
               static_cast<double>(info.duration_us) * 1e-6, info.frames,
               info.complete ? "" : "; it was cut off, what is whole is played");
  Replayer replayer(command, std::move(*reader));
  if (auto played = replayer.run(interrupt); !played) return report_failure(played.error());
  const auto report = replayer.report();
  spdlog::info("sent {} poses, {} dropped", report["frames_sent"].get<std::uint64_t>(),
               report["frames_dropped"].get<std::uint64_t>());
  return end_with_report(command.json, report.dump(2));
}

}  // namespace eigencast
