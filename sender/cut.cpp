// SPDX-License-Identifier: MIT
#include "sender/cut.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <set>
#include <string_view>
#include <utility>
#include <variant>

#include "common/codec/recaller.h"
#include "common/core/bytes.h"
#include "common/recording/reader.h"
#include "common/recording/writer.h"
#include "common/wire/control.h"
#include "sdk/asset_folder.h"
#include "sdk/key_writer.h"
#include "sdk/recorded_stream.h"
#include "sender/clip_recording.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;
using recording::Record;
using recording::Type;

constexpr TimeUs kBetweenFilesUs = 33'333;

std::string_view text_of(const Bytes& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// Which poses stay at a lower rate: of each period the one nearest to its beginning.
class Thinning {
 public:
  explicit Thinning(double rate_hz) : period_us_(1e6 / rate_hz) {}
  bool keeps(TimeUs capture_us) {
    const auto now_us = static_cast<double>(capture_us);
    const double half_us = (now_us - std::exchange(newest_us_, now_us)) / 2;
    const double at_us = now_us + (half_us > 0 ? half_us : 0);
    if (at_us < due_us_) return false;
    const double from_us = std::isnan(due_us_) ? now_us : due_us_;
    due_us_ = from_us + period_us_ * (std::floor((at_us - from_us) / period_us_) + 1);
    return true;
  }

 private:
  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  double period_us_;
  double newest_us_ = kNone, due_us_ = kNone;
};

/// Writes ranges of recordings after one another. Times of the result run on.
class Cutter {
 public:
  Cutter(recording::Writer writer, const std::function<Result<Bytes>(const Sha256&)>& missing)
      : writer_(std::move(writer)), missing_(missing) {}

  Result<void> copy_objects(recording::Reader& reader) {
    const auto offsets = reader.object_offsets();
    if (!offsets) return offsets.error();
    for (const std::uint64_t offset : *offsets) {
      const auto object = reader.object_at(offset);
      if (!object) return object.error();
      const ByteView bytes = ByteView(object->body).subspan(recording::kIdBytes);
      const Sha256 id = sha256(bytes);
      if (!copied_.insert(id).second) continue;
      if (const auto written = writer_.object(0, id.digest, bytes); !written) return written;
    }
    return {};
  }

  /// The range in microseconds since the start of this recording.
  Result<void> copy(recording::Reader& reader, TimeUs from_us, TimeUs until_us) {
    if (const auto sought = reader.seek(from_us); !sought) return sought;
    std::optional<TimeUs> first_us;
    std::optional<Record> announce;  // Until a checkpoint follows, which makes the poses behind it readable.
    Bytes memory;
    for (;;) {
      auto record = reader.next();
      if (!record) return record.error();
      if (!*record || (**record).time_us > until_us) break;
      const TimeUs time_us = (**record).time_us;
      const Bytes& body = (**record).body;
      const auto at_us = [&] { return begun_us_ + std::max<TimeUs>(0, time_us - first_us.value_or(time_us)); };
      Result<void> written;
      switch ((**record).type) {
        case Type::kAnnounce:
          announce = std::move(**record);
          memory.clear();
          break;
        case Type::kMemory:
          memory = body;
          break;
        case Type::kCheckpoint:
          if (!first_us) first_us = time_us;
          if (announce) {
            add_asset(text_of(announce->body), missing_);
            written = writer_.announce(at_us(), text_of(announce->body), memory);
          }
          announce.reset();
          if (written) written = writer_.checkpoint(at_us(), body);
          break;
        case Type::kFrame:
          if (first_us && !announce) written = writer_.frame(at_us(), body);
          break;
        case Type::kGap:
          if (first_us && !announce) written = writer_.gap(at_us(), ByteReader(body).u64());
          break;
        default:
          break;
      }
      if (!written) return written;
    }
    if (first_us) begun_us_ = writer_.duration_us() + kBetweenFilesUs;
    return {};
  }

  /// The same with fewer poses, predicted from the same memories.
  Result<void> thin(const std::string& file, TimeUs from_us, TimeUs until_us, double rate_hz) {
    auto stream = RecordedStream::open(file);
    if (!stream) return stream.error();
    if (const auto sought = stream->seek(from_us); !sought) return sought;
    const auto object_of = [&](const Sha256& id) -> Result<Bytes> {
      auto held = stream->object(id);
      return held || !missing_ ? std::move(held) : missing_(id);
    };
    std::optional<TimeUs> first_us;
    std::string text;
    std::optional<KeyWriter> keys;
    Thinning thinning(rate_hz);
    RecordedStream::Memory memory;
    std::optional<Bytes> memory_used;  ///< The ids of its segments, once it is announced.
    std::uint8_t coarse = 0;           ///< As the sender coded the newest key.
    TimeUs due_us = 0, newest_us = 0;
    bool is_again = false;  ///< The announcement came again since the newest pose.
    bool is_new = true;     ///< What memory_used says may differ from the memory.
    const auto begin = [&] {
      add_asset(text, object_of);
      keys.emplace(stream->layout(), std::uint8_t{0}, std::nullopt);
      keys->begin({});
      memory_used.reset();
      is_new = true;
      thinning = Thinning(rate_hz);
    };
    const auto as_coarse = [&](const ChainState& state, const Key& key, auto) {
      return encode_key(keys->layout(), state, key, coarse);
    };
    const auto announce_memory = [&](TimeUs time_us) -> Result<void> {
      Bytes ids;
      PoseMemory poses(keys->layout());
      for (const CodedSegment& segment : memory) {
        const Sha256 id = sha256(segment.bytes);
        ids.insert(ids.end(), id.digest.begin(), id.digest.end());
        add({id, segment.bytes});
        if (const auto grown = poses.add(segment.segment); !grown) return grown;
      }
      if (ids == memory_used) return {};
      if (const auto written = writer_.announce(time_us, text, ids); !written) return written;
      memory_used = std::move(ids);
      due_us = 0;  // What follows begins with a checkpoint.
      if (memory.empty()) {
        keys->code_by(as_coarse, std::nullopt, false);
        return {};
      }
      const auto recaller = std::make_shared<Recaller>(poses);
      const auto recalled = [&coarse, recaller](const ChainState& state, const Key& key, auto) {
        return recaller->encode(state, key, coarse);
      };
      keys->code_by(recalled, std::move(poses), false);
      return {};
    };
    for (;;) {
      auto event = stream->next();
      if (!event) return event.error();
      if (!*event || (**event).time_us > until_us) break;
      const TimeUs time_us = begun_us_ + std::max<TimeUs>(0, (**event).time_us - first_us.value_or((**event).time_us));
      if (auto* announce = std::get_if<control::Announce>(&(**event).what)) {
        if (announce->key_rate_hz > 0) announce->key_rate_hz = std::min(announce->key_rate_hz, rate_hz);
        memory.clear();
        is_new = true;
        std::string said = text_from_control(*announce);
        is_again = said == std::exchange(text, said);  // Of another memory, or of a recording joined here.
        if (is_again) continue;
        begin();
      }
      if (auto* kept = std::get_if<RecordedStream::Memory>(&(**event).what)) {
        memory = std::move(*kept);
        is_new = true;
      }
      auto* pose = std::get_if<RecordedPose>(&(**event).what);
      if (pose != nullptr && !pose->coded.empty()) coarse = half_spacing_of(pose->coded);
      if (pose == nullptr || !keys) continue;
      const bool is_older = pose->capture_us < std::exchange(newest_us, pose->capture_us);
      if (std::exchange(is_again, false) && is_older) begin();
      if (!thinning.keeps(pose->capture_us)) continue;
      if (!keys->may_follow(pose->capture_us)) continue;
      if (!first_us) first_us = (**event).time_us;
      if (std::exchange(is_new, false)) {
        if (const auto announced = announce_memory(time_us); !announced) return announced;
      }
      auto coded = keys->code(std::move(pose->key), pose->capture_us);
      if (!coded) return coded.error();
      if (const auto written = record_key(writer_, *keys, *std::move(coded), time_us, due_us); !written) return written;
    }
    if (first_us) begun_us_ = writer_.duration_us() + kBetweenFilesUs;
    return {};
  }

  /// Errors: kInvalidArgument: there is no pose.
  Result<CutFacts> finish() {
    if (begun_us_ == 0) return fail(ErrorCode::kInvalidArgument, "the range holds no pose");
    const CutFacts facts{writer_.duration_us(), writer_.frames(), 0};
    if (const auto finished = writer_.finish(); !finished) return finished.error();
    return CutFacts{facts.duration_us, facts.frames, writer_.bytes()};
  }

 private:
  /// As far as it is there: who reads the result sees what it holds.
  void add_asset(std::string_view text, const std::function<Result<Bytes>(const Sha256&)>& object_of) {
    const auto message = control_from_text(text);
    const auto* announce = message ? std::get_if<control::Announce>(&*message) : nullptr;
    const auto id = announce != nullptr ? Sha256::from_hex(announce->asset) : std::nullopt;
    if (!object_of || !id || copied_.contains(*id)) return;
    const auto whole = assemble_asset(*id, object_of);
    if (!whole) return;
    for (const auto* parts : {&whole->encoded.chunks, &whole->encoded.sections}) {
      for (const AssetObject& part : *parts) add(part);
    }
    add(whole->encoded.manifest);
  }
  void add(const AssetObject& object) {
    if (copied_.insert(object.id).second) (void)writer_.object(writer_.duration_us(), object.id.digest, object.bytes);
  }

  recording::Writer writer_;
  const std::function<Result<Bytes>(const Sha256&)>& missing_;
  std::set<Sha256> copied_;
  TimeUs begun_us_ = 0;  ///< Where the next recording begins.
};

}  // namespace

Result<CutFacts> cut_recordings(const std::vector<std::string>& files, double from_s, double duration_s, double rate_hz,
                                const std::string& to, const std::function<Result<Bytes>(const Sha256&)>& missing) {
  std::error_code ignored;
  if (fs::exists(to, ignored)) return fail(ErrorCode::kInvalidArgument, to + ": is there already; name another file");
  std::vector<recording::Reader> readers;
  for (const std::string& file : files) {
    auto reader = recording::Reader::open(file);
    if (!reader) return reader.error();
    readers.push_back(*std::move(reader));
  }
  const std::string part = to + ".part";
  fs::remove(part, ignored);
  const auto made = [&]() -> Result<CutFacts> {
    auto writer = recording::Writer::create(part, readers.front().info().start);
    if (!writer) return writer.error();
    Cutter cutter(*std::move(writer), missing);
    for (std::size_t i = 0; i < readers.size(); ++i) {
      if (rate_hz > 0) break;
      if (const auto copied = cutter.copy_objects(readers[i]); !copied) return in_context(files[i], copied.error());
    }
    // The range counts through all recordings.
    auto from_us = static_cast<TimeUs>(std::llround(from_s * 1e6));
    TimeUs left_us = duration_s > 0 ? static_cast<TimeUs>(std::llround(duration_s * 1e6)) : INT64_MAX / 4;
    for (std::size_t i = 0; i < readers.size() && left_us > 0; ++i) {
      const TimeUs length_us = readers[i].info().duration_us;
      if (from_us > length_us) {
        from_us -= length_us;
        continue;
      }
      const TimeUs until_us = std::min(from_us + left_us, length_us);
      const auto copied =
          rate_hz > 0 ? cutter.thin(files[i], from_us, until_us, rate_hz) : cutter.copy(readers[i], from_us, until_us);
      if (!copied) return in_context(files[i], copied.error());
      left_us -= until_us - from_us;
      from_us = 0;
    }
    return cutter.finish();
  }();
  std::error_code code;
  if (made) fs::rename(part, to, code);
  if (!made || code) fs::remove(part, ignored);
  if (code) return fail(ErrorCode::kIo, to + ": cannot be written: " + code.message());
  return made;
}

}  // namespace eigencast
