// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace eigencast {

/// How far each vertex of what is shown is from where the source has it.
///
/// Not thread-safe.
class Truth {
 public:
  virtual ~Truth() = default;
  /// Distances of the first `errors.size()` vertices, in the asset's units. C: r x channels, of the pose shown;
  /// positions: N x 3, rebuilt from it. False: not known (yet), and why() says why.
  virtual bool errors(std::span<const double> C, std::uint32_t channels, std::span<const float> positions,
                      std::span<float> errors) = 0;
  virtual std::string why() const = 0;
};

}  // namespace eigencast
