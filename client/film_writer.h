// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "client/film_plan.h"
#include "view/picture.h"

namespace eigencast {

/// Writes the pictures of a film: PNG files, or a video through ffmpeg. Not thread-safe.
///
/// A video is written under a temporary name (.partial) until finish(); without it, or after an error, nothing is left.
/// Of pictures, those that were added stay.
class FilmWriter {
 public:
  /// Errors: kNotFound (ffmpeg is not installed), kIo (nothing can be written there), kInvalidArgument (an mp4 of odd
  /// size).
  static Result<std::unique_ptr<FilmWriter>> create(const FilmTarget& target, int width, int height, double fps);
  virtual ~FilmWriter() = default;

  /// Blocks while ffmpeg is busy. Errors: kIo, with what ffmpeg said. REQUIRES: a picture of that size.
  virtual Result<void> add(const Picture& picture) = 0;
  /// Call once, after the last picture. Errors: kIo.
  virtual Result<void> finish() = 0;
};

}  // namespace eigencast
