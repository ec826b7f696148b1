// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>

#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast {

/// The clock of a film: which moment each of its pictures shows, in constant steps, however long they take. Pure.
class FilmClock {
 public:
  static constexpr std::uint64_t kMaxPictures = 10'000'000;

  /// Rounds to whole pictures, one at least. Errors: kInvalidArgument (not above 0), kTooLarge (kMaxPictures).
  static Result<FilmClock> create(double seconds, double fps);

  std::uint64_t pictures() const { return pictures_; }
  double fps() const { return fps_; }
  /// Microseconds since the film's beginning, each rounded for itself. REQUIRES: picture <= pictures().
  TimeUs time_us(std::uint64_t picture) const;

 private:
  FilmClock(std::uint64_t pictures, double fps) : pictures_(pictures), fps_(fps) {}
  std::uint64_t pictures_;
  double fps_;
};

/// Where a film goes.
struct FilmTarget {
  enum class Kind { kMp4, kWebm, kPictures };
  Kind kind = Kind::kMp4;
  std::string path;  ///< Of kPictures: with the number's format.

  /// path: ends in .mp4 or .webm; or in .png, with one %d or %04d (any width up to 9). Errors: kInvalidArgument.
  static Result<FilmTarget> from_path(const std::string& path);
  /// The file of a picture, from 1 on. REQUIRES: kPictures.
  std::string picture_path(std::uint64_t number) const;
};

struct FilmOptions {
  FilmTarget target;
  double fps = 60;
  double seconds = 0;  ///< 0: of the camera path, the turntable or the longest clip.
};

}  // namespace eigencast
