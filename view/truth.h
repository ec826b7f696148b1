// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace eigencast {

/// Distances between the vertices shown and the exact surface. Not thread-safe.
class Truth {
 public:
  virtual ~Truth() = default;
  /// Sets the distances of the first vertices, in the asset's units; false if they are unknown, see why().
  ///   C          r x channels, of the pose shown
  ///   positions  N x 3, rebuilt from C
  virtual bool errors(std::span<const double> C, std::uint32_t channels, std::span<const float> positions,
                      std::span<float> errors) = 0;
  virtual std::string why() const = 0;
};

}  // namespace eigencast
