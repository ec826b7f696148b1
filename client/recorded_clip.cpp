// SPDX-License-Identifier: MIT
#include "client/recorded_clip.h"

#include <algorithm>
#include <map>
#include <utility>
#include <variant>

#include "common/recording/reader.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "sdk/asset_cache.h"
#include "sdk/asset_folder.h"
#include "sdk/frame_decoder.h"

namespace eigencast {
namespace {

using recording::Record;
using recording::Type;

constexpr std::size_t kMaxCoefficientBytes = std::size_t{1} << 30;
constexpr TimeUs kLongestPauseUs = 5'000'000;  // as eigencast-sender replay has it

/// Decodes the records of a recording, in their order, to the poses of one clip.
class RecordedPoses {
 public:
  RecordedPoses(recording::Reader& reader, const std::string& cache_dir, BakedClip& clip)
      : reader_(reader), cache_(cache_dir), clip_(clip) {}

  Result<void> take(const Record& record) {
    if (record.type == Type::kAnnounce) return begin(record);
    if (record.type == Type::kMemory) return remember(record.body);
    if (record.type != Type::kFrame && record.type != Type::kCheckpoint) return {};
    const auto parsed = parse_frame(record.body);
    if (!parsed) return parsed.error();
    const auto frame = envelopes_.read(*parsed);
    if (!frame) return {};  // behind a gap: the checkpoint that bridges it comes
    const auto key = decoder_.decode(*frame);
    if (!key) return key.error();
    if (*key == nullptr) return {};
    const TimeUs capture_us = frame->envelope.capture_us;
    if (last_capture_us_ && capture_us <= *last_capture_us_) return {};  // a checkpoint of what is there
    return add(**key, capture_us, record.time_us);
  }

 private:
  Result<void> begin(const Record& record) {
    const auto message =
        control_from_text(std::string_view(reinterpret_cast<const char*>(record.body.data()), record.body.size()));
    if (!message) return in_context("the recorded announcement", message.error());
    const auto* announce = std::get_if<control::Announce>(&*message);
    if (announce == nullptr) return fail(ErrorCode::kCorrupt, "the recorded announcement is none");
    if (const auto usable = check_format(announce->format); !usable) return usable;
    if (clip_.info && (clip_.info->asset != announce->asset || clip_.info->format != announce->format))
      return fail(ErrorCode::kUnsupported,
                  "its sender changes the surface on the way; eigencast-sender replay plays it");
    control::StreamInfo info;
    info.stream = reader_.info().start.stream;
    info.state = control::StreamInfo::State::kLive;
    info.epoch = ++epoch_;
    info.asset = announce->asset;
    info.format = announce->format;
    info.key_rate_hz = announce->key_rate_hz;
    info.world = announce->world;
    if (!clip_.info) {
      if (const auto read = read_surface(info); !read) return read;
    }
    envelopes_.begin(0, 0, epoch_);
    decoder_.set_stream(info);
    last_capture_us_.reset();
    return {};
  }

  /// REQUIRES: it is held.
  Result<Bytes> object_of(const Sha256& id) {
    const auto object = reader_.object_at(held_.at(id));
    if (!object) return object.error();
    return Bytes(object->body.begin() + recording::kIdBytes, object->body.end());
  }

  /// The poses that later keys are predicted from. Errors: kCorrupt, those of decode_segment.
  Result<void> remember(ByteView ids) {
    const auto asset = clip_.info ? Sha256::from_hex(clip_.info->asset) : std::nullopt;
    if (!asset || decoder_.layout().is_float() || ids.size() % recording::kIdBytes != 0)
      return fail(ErrorCode::kCorrupt, "a memory without an announcement that it fits");
    decoder_.set_memory(std::nullopt);
    for (; !ids.empty(); ids = ids.subspan(recording::kIdBytes)) {
      Sha256 id;
      std::copy_n(ids.begin(), recording::kIdBytes, id.digest.begin());
      if (!held_.contains(id))
        return fail(ErrorCode::kCorrupt, "the recording lacks segment " + id.hex() + " of a memory");
      const auto coded = object_of(id);
      if (!coded) return coded.error();
      auto segment = decode_segment(decoder_.layout(), asset->digest, *coded);
      if (!segment) return segment.error();
      if (const auto grown = decoder_.remember(*std::move(segment)); !grown) return grown;
    }
    return {};
  }

  Result<void> read_surface(const control::StreamInfo& info) {
    const auto id = Sha256::from_hex(info.asset);
    if (!id) return fail(ErrorCode::kCorrupt, "the recorded announcement names no surface");
    const auto offsets = reader_.object_offsets();
    if (!offsets) return offsets.error();
    for (const std::uint64_t offset : *offsets) {
      const auto object = reader_.object_at(offset);
      if (!object) return object.error();
      held_.emplace(sha256(ByteView(object->body).subspan(recording::kIdBytes)), offset);
    }
    auto whole = assemble_asset(*id, [&](const Sha256& wanted) -> Result<Bytes> {
      if (held_.contains(wanted)) return object_of(wanted);
      if (auto cached = cache_.load(wanted)) return *std::move(cached);
      return fail(ErrorCode::kNotFound,
                  "it does not hold its surface, and the cache has not seen it: watch the stream once, or record with "
                  "recording.include_asset = true");
    });
    if (!whole) return whole.error();
    if (whole->asset.rank != info.format.rows)
      return fail(ErrorCode::kCorrupt, "the recorded poses do not fit their surface");
    clip_.asset = std::move(whole->asset);
    clip_.info = info;
    return {};
  }

  Result<void> add(const Key& key, TimeUs capture_us, TimeUs recorded_us) {
    std::vector<double> C = decoder_.coefficients(key);
    const CoefficientLayout& layout = decoder_.layout();
    for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
      if (key.bands.has(band)) continue;
      const auto [first, last] = layout.range(band);
      for (std::size_t row = first / layout.channels; row < last / layout.channels; ++row)
        std::copy_n(clip_.asset.rest.begin() + static_cast<std::ptrdiff_t>(3 * row), 3, &C[row * layout.channels]);
    }
    bytes_ += C.size() * sizeof(double);
    if (bytes_ > kMaxCoefficientBytes)
      return fail(ErrorCode::kTooLarge, "over 1 GiB of coefficients; eigencast-sender replay streams any number");
    const TimeUs since_us = last_capture_us_ ? capture_us - *last_capture_us_ : recorded_us - last_recorded_us_;
    const TimeUs before_us = clip_.times_us.empty() ? 0 : clip_.times_us.back();
    clip_.times_us.push_back(clip_.frames.empty() ? 0 : before_us + std::clamp<TimeUs>(since_us, 1, kLongestPauseUs));
    clip_.frames.push_back(std::move(C));
    last_capture_us_ = capture_us;
    last_recorded_us_ = recorded_us;
    return {};
  }

  recording::Reader& reader_;
  const AssetCache cache_;
  BakedClip& clip_;
  EnvelopeReader envelopes_;
  FrameDecoder decoder_;
  std::map<Sha256, std::uint64_t> held_;  ///< Objects, and where they are.
  std::uint32_t epoch_ = 0;
  std::optional<TimeUs> last_capture_us_;
  TimeUs last_recorded_us_ = 0;
  std::size_t bytes_ = 0;
};

Result<void> read_all(recording::Reader& reader, RecordedPoses& poses, const BakeProgress& progress) {
  const auto length = static_cast<double>(std::max<TimeUs>(1, reader.info().duration_us));
  for (;;) {
    const auto record = reader.next();
    if (!record) return record.error();
    if (!*record) return {};
    if (const auto taken = poses.take(**record); !taken) return taken;
    if (progress && !progress(static_cast<double>((**record).time_us) / length, "reading the recording"))
      return fail(ErrorCode::kCancelled, "stopped");
  }
}

}  // namespace

bool is_recording(const std::string& path) {
  return path.ends_with(".ecrec");
}

Result<std::shared_ptr<const BakedClip>> read_recording(const std::string& path, const std::string& cache_dir,
                                                        const BakeProgress& progress) {
  auto reader = recording::Reader::open(path);
  if (!reader) return reader.error();
  auto clip = std::make_shared<BakedClip>();
  RecordedPoses poses(*reader, cache_dir, *clip);
  if (const auto read = read_all(*reader, poses, progress); !read) return in_context(path, read.error());
  if (clip->frames.empty()) return fail(ErrorCode::kCorrupt, path + ": the recording has no poses");
  clip->name = clip->info->stream;
  clip->asset_id = clip->info->asset;
  clip->rate_hz = clip->info->key_rate_hz;
  const std::size_t steps = clip->times_us.size() - 1;
  // The last pose lasts as long as the others do.
  clip->period_us = clip->times_us.back() + (steps > 0 ? clip->times_us.back() / static_cast<TimeUs>(steps) : 33'333);
  clip->is_cycle = ends_where_it_begins(clip->frames);
  return std::shared_ptr<const BakedClip>(std::move(clip));
}

}  // namespace eigencast
