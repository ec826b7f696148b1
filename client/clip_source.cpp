// SPDX-License-Identifier: MIT
#include "client/clip_source.h"

#include <fnmatch.h>
#include <strings.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <exception>
#include <filesystem>
#include <utility>

#include "client/clip_truth.h"
#include "common/core/text.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/recorded_clip.h"

namespace eigencast {
namespace {

constexpr std::size_t kMaxBytes = std::size_t{1} << 30;

namespace fs = std::filesystem;

/// Describes the files of a path, folder or glob, to detect changes.
struct Stamp {
  std::uint64_t files = 0, bytes = 0;
  fs::file_time_type newest = fs::file_time_type::min();
  bool operator==(const Stamp&) const = default;

  void add(const fs::directory_entry& file) {
    std::error_code gone;
    if (!file.is_regular_file(gone)) return;
    ++files;
    if (const std::uintmax_t size = file.file_size(gone); !gone) bytes += size;
    if (const auto written = file.last_write_time(gone); !gone) newest = std::max(newest, written);
  }
};

Stamp stamp_of(const std::string& input) {
  Stamp stamp;
  std::error_code gone;
  const fs::path path(input);
  const bool is_folder = fs::is_directory(path, gone);
  if (!is_folder && fs::exists(path, gone)) {
    stamp.add(fs::directory_entry(path, gone));
    return stamp;
  }
  const fs::path folder = is_folder ? path : path.has_parent_path() ? path.parent_path() : fs::path(".");
  const std::string pattern = is_folder ? "*" : path.filename().string();
  for (auto file = fs::directory_iterator(folder, gone); !gone && file != fs::directory_iterator();
       file.increment(gone)) {
    if (::fnmatch(pattern.c_str(), file->path().filename().c_str(), FNM_PERIOD) == 0) stamp.add(*file);
  }
  return stamp;
}

/// "%20" becomes a blank; what is not two hexadecimal digits stays, as does %00, which no path has.
std::string without_escapes(const std::string& text) {
  std::string plain;
  for (std::size_t i = 0; i < text.size(); ++i) {
    unsigned char byte = 0;
    const char* digits = text.data() + i + 1;
    const bool escaped = text[i] == '%' && i + 2 < text.size() &&
                         std::from_chars(digits, digits + 2, byte, 16).ptr == digits + 2 && byte != 0;
    plain += escaped ? static_cast<char>(byte) : text[i];
    i += escaped ? 2 : 0;
  }
  return plain;
}

}  // namespace

namespace {

bool is_on_disk(const std::string& input) {
  std::error_code hidden;
  return input.find_first_of("*?[") != std::string::npos || fs::exists(input, hidden) || hidden;
}

}  // namespace

Result<std::unique_ptr<MotionClip>> open_input(const std::string& input) {
  if (is_on_disk(input)) return open_clip(input);
  auto shape = builtin_clip(input);
  if (shape) return shape;
  return fail(ErrorCode::kNotFound, input + ": no such file or folder, and " + shape.error().message);
}

Result<void> check_input(const std::string& input) {
  if (is_on_disk(input)) return {};
  const auto shape = open_input(input);
  return shape ? Result<void>() : shape.error();
}

Result<std::vector<std::vector<double>>> project_clip(const MotionClip& clip, const Asset& asset,
                                                      const BakeProgress& progress) {
  if (clip.frame_count() > kMaxBytes / (asset.rest.size() * sizeof(double)))
    return fail(ErrorCode::kTooLarge,
                std::to_string(clip.frame_count()) +
                    " frames are over 1 GiB of coefficients; eigencast-sender play streams any number");
  const auto projector = Projector::create(asset);
  if (!projector) return projector.error();
  std::vector<std::vector<double>> frames;
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    if (progress && !progress(static_cast<double>(frame) / static_cast<double>(clip.frame_count()), "reading frames"))
      return fail(ErrorCode::kCancelled, "stopped at frame " + std::to_string(frame));
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    static_assert(sizeof(Vec3) == 3 * sizeof(double));
    auto C = projector->coefficients_from_positions(std::span<const double>(pose->front().data(), 3 * pose->size()));
    if (!C) return in_context("frame " + std::to_string(frame), C.error());
    frames.push_back(std::move(*C));
  }
  return frames;
}

std::optional<std::string> clip_in(const std::string& stream) {
  constexpr std::string_view kScheme = "file:";
  if (::strncasecmp(stream.c_str(), kScheme.data(), kScheme.size()) != 0) return std::nullopt;
  const std::string path = stream.substr(kScheme.size());
  for (const std::string_view authority : {"//", "//localhost"}) {
    if (path.starts_with(std::string(authority) + "/")) return without_escapes(path.substr(authority.size()));
  }
  return path;
}

namespace {

Result<std::shared_ptr<const BakedClip>> open_recording(const std::string& path, const std::string& cache_dir,
                                                        const BakeProgress& progress) {
  auto read = read_recording(path, cache_dir, progress);
  if (!read) return read.error();
  auto clip = std::make_shared<BakedClip>();
  clip->period_us = read->period_us();
  clip->name = read->info.stream;
  clip->asset_id = read->info.asset;
  clip->rate_hz = read->info.key_rate_hz;
  clip->asset = std::move(read->asset);
  clip->frames = std::move(read->frames);
  clip->times_us = std::move(read->times_us);
  clip->utc_us = std::move(read->utc_us);
  clip->is_cycle = ends_where_it_begins(clip->frames);
  clip->info = std::move(read->info);
  return std::shared_ptr<const BakedClip>(std::move(clip));
}

/// Of the folder where it says more: frames/, horse/vertices.npy.
std::string name_of(const std::string& input) {
  fs::path path(input);
  if (!path.has_filename() || path.filename() == "vertices.npy") path = path.parent_path();
  return (path.has_filename() ? path : fs::path(input)).stem().string();
}

}  // namespace

Result<std::shared_ptr<const BakedClip>> BakedClip::open(const std::string& input, const std::string& cache_dir,
                                                         const BakeProgress& progress, const LogSink& log) {
  if (is_recording(input)) return open_recording(input, cache_dir, progress);
  auto clip = open_input(input);
  if (!clip) return clip.error();
  if (const Appearance* appearance = (*clip)->appearance()) {
    for (const std::string& what : appearance->missing) eigencast::log(log, LogLevel::kWarning, what);
  }
  BakeOptions options;
  options.name = name_of(input);
  options.appearance = (*clip)->appearance();
  const KnownMotion motion = motion_of(**clip);
  options.motion = &motion;
  auto result = bake((*clip)->rest(), options, cache_dir, progress);
  if (!result) return in_context(input, result.error());
  auto baked = std::make_shared<BakedClip>();
  baked->name = options.name;
  baked->asset_id = result->encoded.manifest.id.hex();
  baked->asset = std::move(result->asset);
  baked->not_kept = std::move(result->not_kept);
  baked->rate_hz = (*clip)->frame_rate_hz();
  const auto good = store(baked->frames, project_clip(**clip, baked->asset, progress));
  if (!good) return in_context(input, good.error());
  baked->motion = std::move(*clip);
  const auto time_us = [&](std::size_t frame) {
    const auto even = static_cast<TimeUs>(std::llround(1e6 * static_cast<double>(frame) / baked->rate_hz));
    return std::max(even, static_cast<TimeUs>(frame));  // absurd rates: no two at one time
  };
  for (std::size_t frame = 0; frame < baked->frames.size(); ++frame) baked->times_us.push_back(time_us(frame));
  baked->period_us = time_us(baked->frames.size());
  baked->is_cycle = ends_where_it_begins(baked->frames);
  return std::shared_ptr<const BakedClip>(std::move(baked));
}

ClipSource::ClipSource(std::shared_ptr<const BakedClip> clip, double phase_s, Clock clock, std::uint32_t epoch)
    : clip_(std::move(clip)),
      waits_(!clock),
      clock_(clock ? std::move(clock) : Clock(steady_now_us)),
      last_capture_us_(clock_() - 1) {
  if (!clip_->frames.empty()) {
    const auto phase_us = static_cast<TimeUs>(std::llround(1e6 * phase_s));
    timeline_ = std::make_unique<Timeline>(clip_->times_us, clip_->period_us, clock_() - phase_us);
  }
  if (clip_->motion && !clip_->frames.empty())
    truth_ = std::make_unique<ClipTruth>(clip_->motion, clip_->frames, clip_->asset.source_vertex, clip_->asset.origin);
  stats_.state = Subscriber::State::kLive;
  if (!clip_->not_kept.empty()) stats_.detail = "the bake is not kept: " + clip_->not_kept;
  info_.emplace();
  if (clip_->info) info_ = clip_->info;
  info_->state = control::StreamInfo::State::kLive;
  info_->epoch = epoch;
  info_->asset = clip_->asset_id;
  if (clip_->info) return;
  info_->stream = clip_->name;
  info_->format = {clip_->asset.rank, 3, clip_->asset.band_ends, "float64"};
  info_->key_rate_hz = clip_->rate_hz;
  info_->profile.rate = Profile::Rate::kRaw;
}

ClipSource::Shown ClipSource::shown_at(TimeUs now_us) const {
  const Timeline::Moment moment = timeline_->at(now_us);
  if (timeline_->interpolates()) return {moment.lap, moment.position_us};
  return {moment.lap, timeline_->times_us()[timeline_->frame_at(moment.position_us)]};
}

/// Of what is shown, which came last.
TimeUs ClipSource::utc_us(TimeUs /*capture_us*/) const {
  const TimeUs position_us = shown_ ? shown_->position_us : 0;
  if (clip_->utc_us.empty()) return position_us;
  const std::vector<TimeUs>&times = clip_->times_us, &utc = clip_->utc_us;
  const std::size_t frame = timeline_->frame_at(position_us);
  const double since_us = static_cast<double>(position_us - times[frame]);
  if (frame + 1 == times.size()) return utc[frame] + std::llround(since_us);
  // A past was played at another speed.
  const double pace =
      static_cast<double>(utc[frame + 1] - utc[frame]) / static_cast<double>(times[frame + 1] - times[frame]);
  return utc[frame] + std::llround(pace * since_us);
}

std::vector<ReceivedPose> ClipSource::poll(std::chrono::milliseconds timeout) {
  if (!timeline_) return {};
  TimeUs now = clock_();
  if (waits_ && shown_ == shown_at(now)) {
    const std::chrono::microseconds next(
        timeline_->until_next_us(now).value_or(std::chrono::microseconds(timeout).count()));
    std::this_thread::sleep_for(std::min<std::chrono::microseconds>(timeout, next));
    now = clock_();
  }
  const Shown shown = shown_at(now);
  if (shown_ == shown) return {};
  shown_ = shown;
  const TimeUs late_us = timeline_->paused() ? 0 : timeline_->at(now).position_us - shown.position_us;
  const TimeUs due_us = now - static_cast<TimeUs>(static_cast<double>(late_us) / timeline_->speed());
  const bool is_frame = timeline_->times_us()[timeline_->frame_at(shown.position_us)] == shown.position_us;
  ReceivedPose pose;
  pose.envelope.kind = is_frame ? FrameKind::kKey : FrameKind::kStep;
  pose.envelope.bands = BandMask::lowest(clip_->asset.band_ends.size());
  pose.envelope.epoch = epoch();
  pose.envelope.sequence = stats_.keys++;
  pose.envelope.capture_us = last_capture_us_ = std::max(due_us, last_capture_us_ + 1);
  pose.arrival_us = pose.decoded_us = now;
  pose.coefficients = clip_->curve().at(shown.position_us, timeline_->looping());
  pose.channels = static_cast<std::uint32_t>(pose.coefficients.size() / clip_->asset.rank);
  stats_.latency_us.add(now - pose.envelope.capture_us);
  return {pose};
}

OpeningClip::OpeningClip(std::string input, std::string cache_dir, bool watched, LogSink log)
    : log_(std::move(log)), detail_("reading " + input) {
  info_.emplace();
  info_->stream = input;
  thread_ = std::thread([this, watched, input = std::move(input), cache_dir = std::move(cache_dir)] {
    watched ? watch(input, cache_dir) : bake(input, cache_dir);
  });
}

OpeningClip::~OpeningClip() {
  {
    const std::lock_guard lock(mutex_);
    stop_.store(true);
  }
  stopping_.notify_all();
  thread_.join();
}

bool OpeningClip::pause() {
  std::unique_lock lock(mutex_);
  return !stopping_.wait_for(lock, kPollInterval, [this] { return stop_.load(); });
}

void OpeningClip::watch(const std::string& input, const std::string& cache_dir) {
  Stamp read = stamp_of(input), seen = read;
  bake(input, cache_dir);
  while (pause()) {
    const Stamp now = stamp_of(input);
    const bool stable = now == std::exchange(seen, now);
    if (now == read || !stable) continue;
    read = now;
    bake(input, cache_dir);
  }
}

void OpeningClip::bake(const std::string& input, const std::string& cache_dir) {
  const auto progress = [this](double fraction, std::string_view stage) {
    const std::lock_guard lock(mutex_);
    detail_ = "preparing: " + std::string(stage) + formatted(" %.0f %%", 100 * fraction);
    return !stop_.load();
  };
  Result<std::shared_ptr<const BakedClip>> made = fail(ErrorCode::kInternal, input + ": baking ended unexpectedly");
  // A surface too large for memory must not end the viewer.
  try {
    made = BakedClip::open(input, cache_dir, progress, log_);
  } catch (const std::exception& error) {
    made = fail(ErrorCode::kInternal, input + ": " + error.what());
  }
  const std::lock_guard lock(mutex_);
  made_ = std::move(made);
}

std::vector<ReceivedPose> OpeningClip::poll(std::chrono::milliseconds timeout) {
  std::optional<Result<std::shared_ptr<const BakedClip>>> made;
  {
    const std::lock_guard lock(mutex_);
    std::swap(made, made_);
  }
  if (made) failed_.reset();
  if (made && !*made) failed_ = made->error().message;
  if (made && *made) playing_ = std::make_unique<ClipSource>(std::move(**made), 0, ClipSource::Clock(), ++times_read_);
  if (playing_) return playing_->poll(timeout);
  std::this_thread::sleep_for(timeout);
  return {};
}

Subscriber::Stats OpeningClip::stats() const {
  if (playing_) {
    Subscriber::Stats stats = playing_->stats();
    if (failed_) stats.detail = "as it was: " + *failed_;
    return stats;
  }
  Subscriber::Stats stats;
  stats.state = failed_ ? Subscriber::State::kRefused : Subscriber::State::kDownloading;
  const std::lock_guard lock(mutex_);
  stats.detail = failed_.value_or(detail_);
  return stats;
}

}  // namespace eigencast
