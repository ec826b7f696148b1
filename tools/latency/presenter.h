// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "common/asset/asset.h"
#include "common/core/result.h"

namespace eigencast::latency {

/// Turns a rebuilt surface into a finished picture off the screen, with the renderer of the viewer: normals, upload,
/// drawing, and the wait until all of it is done. A display's own wait (its refresh, its panel) is not part of it.
///
/// Use from the thread that made it only.
class Presenter {
 public:
  virtual ~Presenter() = default;
  /// Returns when the picture is finished. positions: N x 3 floats, the first N vertices of the asset.
  virtual void present(const Asset& asset, std::uint32_t N, std::span<const float> positions) = 0;
  /// The graphics driver's name for itself.
  virtual std::string device() const = 0;
};

struct PictureSize {
  int width = 0, height = 0;
};
/// Of "WIDTHxHEIGHT". Errors: kInvalidArgument.
Result<PictureSize> picture_size_from_text(const std::string& text);

/// Errors: kUnsupported (no OpenGL here, or this program was built
/// without the viewer's renderer).
Result<std::unique_ptr<Presenter>> make_presenter(const PictureSize& size);

}  // namespace eigencast::latency
