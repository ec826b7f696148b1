// SPDX-License-Identifier: MIT
#include "client/opening_clip.h"

#include <fnmatch.h>

#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <utility>

namespace eigencast {
namespace {

namespace fs = std::filesystem;

/// The count, size and age of the files of a path, folder or glob, to detect changes.
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

}  // namespace

OpeningClip::OpeningClip(std::string input, std::string cache_dir, bool watched) : detail_("reading " + input) {
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
    char percent[16];
    std::snprintf(percent, sizeof percent, " %.0f %%", 100 * fraction);
    const std::lock_guard lock(mutex_);
    detail_ = "preparing: " + std::string(stage) + percent;
    return !stop_.load();
  };
  Result<std::shared_ptr<const BakedClip>> made = fail(ErrorCode::kInternal, input + ": baking ended unexpectedly");
  // A surface too large for memory must not end the viewer.
  try {
    made = BakedClip::open(input, cache_dir, progress);
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
