// SPDX-License-Identifier: MIT
#include "sdk/recorded_clip.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <variant>

#include "sdk/asset_cache.h"
#include "sdk/asset_folder.h"
#include "sdk/recorded_stream.h"
#include "sdk/transfer.h"

namespace eigencast {
namespace {

constexpr std::size_t kMaxCoefficientBytes = std::size_t{1} << 30;
constexpr TimeUs kLongestPauseUs = 5'000'000;  // as eigencast-sender replay has it
/// A capture time follows the one before where both lie as far apart as their arrivals, but for so much.
constexpr TimeUs kJitterUs = 1'000'000, kJitterOfSessionsUs = 100'000;

/// Makes the poses of a recording to those of one clip.
class RecordedPoses {
 public:
  RecordedPoses(RecordedStream& stream, const std::string& cache_dir, RecordedClip& clip)
      : stream_(stream), cache_(cache_dir), clip_(clip) {}

  Result<void> take(const RecordedStream::Event& event) {
    if (const auto* announce = std::get_if<control::Announce>(&event.what)) return begin(*announce);
    if (const auto* pose = std::get_if<RecordedPose>(&event.what)) return add(*pose, event.time_us);
    return {};
  }

 private:
  Result<void> begin(const control::Announce& announce) {
    follows_ = false;
    utc_us_ = announce.utc_us;
    if (has_begun_ && clip_.info.asset == announce.asset && clip_.info.format == announce.format) return {};
    if (has_begun_ && !announce.continues) return another_surface();
    auto asset = surface_of(announce);
    if (!asset) return asset.error();
    if (has_begun_) {
      if (const auto moved = move_to(*asset, announce); !moved) return moved;
    }
    clip_.info.stream = stream_.info().start.stream;
    clip_.info.state = control::StreamInfo::State::kLive;
    clip_.info.asset = announce.asset;
    clip_.info.format = announce.format;
    clip_.info.key_rate_hz = announce.key_rate_hz;
    clip_.info.world = announce.world;
    clip_.asset = *std::move(asset);
    has_begun_ = true;
    return {};
  }

  Result<Asset> surface_of(const control::Announce& announce) {
    auto whole = assemble_asset(*Sha256::from_hex(announce.asset), [&](const Sha256& wanted) -> Result<Bytes> {
      auto held = stream_.object(wanted);
      if (held || held.error().code != ErrorCode::kNotFound) return held;
      if (auto cached = cache_.load(wanted)) return *std::move(cached);
      return fail(ErrorCode::kNotFound,
                  "it does not hold its surface, and the cache has not seen it: watch the stream once, or record with "
                  "recording.include_asset = true");
    });
    if (!whole) return whole.error();
    if (whole->asset.rank != announce.format.rows)
      return fail(ErrorCode::kCorrupt, "the recorded poses do not fit their surface");
    return std::move(whole->asset);
  }

  /// The poses so far, in the basis that the sender goes on in.
  Result<void> move_to(const Asset& asset, const control::Announce& announce) {
    const std::uint32_t channels = announce.format.channels;
    if (Transfer::cost(clip_.asset, asset).bytes > kMaxCoefficientBytes) return too_large();
    const auto transfer = channels == clip_.info.format.channels ? Transfer::between(clip_.asset, asset) : std::nullopt;
    if (!transfer) return another_surface();
    bytes_ = clip_.frames.size() * asset.rank * channels * sizeof(double);
    if (bytes_ > kMaxCoefficientBytes) return too_large();
    for (std::vector<double>& C : clip_.frames) C = transfer->apply(C, channels);
    return {};
  }

  static Error another_surface() {
    return fail(ErrorCode::kUnsupported, "its sender changes the surface on the way; eigencast-sender replay plays it");
  }
  static Error too_large() {
    return fail(
        ErrorCode::kTooLarge,
        "over 1 GiB of coefficients, or to take them to another basis; eigencast-sender replay streams any number");
  }

  /// Since the pose before it. A sender that comes back may have another clock, and what is between may be cut out.
  TimeUs pause_us(TimeUs capture_us, TimeUs recorded_us) const {
    const TimeUs arrival_us = recorded_us - last_recorded_us_;
    if (capture_us <= last_capture_us_) return arrival_us;
    const TimeUs since_us = capture_us - last_capture_us_;
    return std::abs(since_us - arrival_us) < (follows_ ? kJitterUs : kJitterOfSessionsUs) ? since_us : arrival_us;
  }

  Result<void> add(const RecordedPose& pose, TimeUs recorded_us) {
    std::vector<double> C = stream_.coefficients(pose.key);
    const CoefficientLayout& layout = stream_.layout();
    for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
      if (pose.key.bands.has(band)) continue;
      const auto [first, last] = layout.range(band);
      for (std::size_t row = first / layout.channels; row < last / layout.channels; ++row)
        std::copy_n(clip_.asset.rest.begin() + static_cast<std::ptrdiff_t>(3 * row), 3, &C[row * layout.channels]);
    }
    bytes_ += C.size() * sizeof(double);
    if (bytes_ > kMaxCoefficientBytes) return too_large();
    clip_.times_us.push_back(clip_.frames.empty()
                                 ? 0
                                 : clip_.times_us.back() +
                                       std::clamp<TimeUs>(pause_us(pose.capture_us, recorded_us), 1, kLongestPauseUs));
    clip_.utc_us.push_back(bounded_time(utc_us_) + bounded_time(pose.capture_us));
    clip_.frames.push_back(std::move(C));
    follows_ = true;
    last_capture_us_ = pose.capture_us;
    last_recorded_us_ = recorded_us;
    return {};
  }

  RecordedStream& stream_;
  const AssetCache cache_;
  RecordedClip& clip_;
  bool has_begun_ = false;
  TimeUs utc_us_ = 0;  ///< Announced.
  TimeUs last_capture_us_ = 0;
  TimeUs last_recorded_us_ = 0;
  bool follows_ = false;  ///< The last pose came behind the same announcement.
  std::size_t bytes_ = 0;
};

Result<void> read_all(RecordedStream& stream, RecordedPoses& poses, const BakeProgress& progress) {
  const auto length = static_cast<double>(std::max<TimeUs>(1, stream.info().duration_us));
  for (;;) {
    const auto event = stream.next();
    if (!event) return event.error();
    if (!*event) return {};
    if (const auto taken = poses.take(**event); !taken) return taken;
    if (progress && !progress(static_cast<double>((**event).time_us) / length, "reading the recording"))
      return fail(ErrorCode::kCancelled, "stopped");
  }
}

}  // namespace

TimeUs RecordedClip::period_us() const {
  const auto steps = static_cast<TimeUs>(times_us.size()) - 1;
  return times_us.back() + (steps > 0 ? times_us.back() / steps : 33'333);
}

bool is_recording(const std::string& path) {
  return path.ends_with(".ecrec");
}

Result<RecordedClip> read_recording(const std::string& path, const std::string& cache_dir,
                                    const BakeProgress& progress) {
  auto stream = RecordedStream::open(path);
  if (!stream) return stream.error();
  RecordedClip clip;
  RecordedPoses poses(*stream, cache_dir, clip);
  if (const auto read = read_all(*stream, poses, progress); !read) return in_context(path, read.error());
  if (clip.frames.empty()) return fail(ErrorCode::kCorrupt, path + ": the recording has no poses");
  return clip;
}

}  // namespace eigencast
