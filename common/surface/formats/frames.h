// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

/// Private to common/surface.
namespace eigencast {

/// The rate of a clip whose source states none.
inline constexpr double kUnstatedRateHz = 30;

/// Where recorded poses come from, in any order; faces where the format has any. Not thread-safe.
class Frames {
 public:
  virtual ~Frames() = default;
  virtual std::size_t count() const = 0;
  virtual double rate_hz() const { return kUnstatedRateHz; }
  /// appearance: filled where the frame states colours; null: unwanted.
  virtual Result<Surface> read(std::size_t frame, Appearance* appearance) const = 0;
  /// "frame 3 of clip.npy", for messages.
  virtual std::string label(std::size_t frame) const = 0;
};

}  // namespace eigencast
