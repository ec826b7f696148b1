// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "common/asset/asset.h"
#include "common/core/result.h"

namespace eigencast::latency {

/// Draws off the screen with the viewer's renderer: normals, upload, drawing, and the wait until all of it is done, but
/// not for a display. Use from the thread that made it only.
class Presenter {
 public:
  virtual ~Presenter() = default;
  /// positions: N x 3 floats, the first N vertices of the asset.
  virtual void present(const Asset& asset, std::uint32_t N, std::span<const float> positions) = 0;
  virtual std::string device() const = 0;
};

struct PictureSize {
  int width = 0, height = 0;
};
/// Reads "WIDTHxHEIGHT". Errors: kInvalidArgument.
Result<PictureSize> picture_size_from_text(const std::string& text);

/// Errors: kUnsupported (no OpenGL here, or a build without the viewer's renderer).
Result<std::unique_ptr<Presenter>> make_presenter(const PictureSize& size);

}  // namespace eigencast::latency
