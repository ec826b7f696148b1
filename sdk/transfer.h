// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast {

/// Poses in one basis as poses in another of the same surface: C_to = T C_from, the best fit at the vertices of both.
class Transfer {
 public:
  /// Nothing where the assets are not of the same vertices in the same order, or too few of them have arrived. Takes
  /// the first kMostVertices, or 8 for each column if that is more: they lie evenly on the surface.
  static std::optional<Transfer> between(const Asset& from, const Asset& to);

  /// About what between() takes at most: bytes of memory beside the assets, and products of two numbers.
  struct Cost {
    std::uint64_t bytes = 0, products = 0;
  };
  static Cost cost(const Asset& from, const Asset& to);

  std::uint32_t from_rank() const { return from_; }
  std::uint32_t to_rank() const { return to_; }
  /// C: from_rank() x channels, row-major; returns to_rank() x channels; empty where sizes do not fit.
  std::vector<double> apply(std::span<const double> C, std::size_t channels) const;

 private:
  static constexpr std::uint32_t kMostVertices = 4096;

  std::uint32_t from_ = 0, to_ = 0;
  std::vector<double> T_;  ///< to x from, row-major.
};

}  // namespace eigencast
