// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast::progressive {

/// Nearest points among some of a set of points.
///
/// Thread-safe after construction.
class Neighbours {
 public:
  /// positions must outlive this; `members` are the numbers of those to search. REQUIRES: members is not empty.
  Neighbours(std::span<const Vec3> positions, std::vector<std::uint32_t> members);
  ~Neighbours();
  Neighbours(const Neighbours&) = delete;
  Neighbours& operator=(const Neighbours&) = delete;

  /// The numbers of the `count` members nearest to p, nearest first (fewer where there are fewer).
  std::vector<std::uint32_t> nearest(const Vec3& p, std::size_t count) const;

 private:
  struct Tree;
  std::unique_ptr<Tree> tree_;
};

}  // namespace eigencast::progressive
