// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast {

/// The triangles of a level of detail that moves, at the cost of the move: from N to N' only the faces of the vertices
/// in between are touched. Going there and back gives the same triangles. After Hoppe 1996, "Progressive Meshes".
///
/// Follows an asset as it arrives. Takes 4 bytes for each corner of a face and level at which that corner changes.
/// Not thread-safe.
class LevelTriangles {
 public:
  /// So many indices are uploaded together.
  static constexpr std::size_t kBlock = 1024;

  /// Takes what has arrived, and gives the triangles of the level, or of as much of it as there is; true if they may
  /// have changed. O(vertices + faces).
  bool update(const Asset& asset, std::vector<std::uint32_t>& triangles);
  /// Before another asset is followed.
  void forget() { rows_ = 0, faces_.clear(); }

  /// Goes to level N and changes `triangles`, which are as the last call left them, to those of triangles_at_level().
  /// REQUIRES: base_count <= N <= rows_ready of the last update().
  void set_level(std::uint32_t N, std::vector<std::uint32_t>& triangles);
  std::uint32_t level() const { return level_; }
  std::span<const std::uint32_t> map() const { return map_; }  ///< Of the rows that have arrived.

  /// Grows with every change.
  std::uint64_t version() const { return version_; }
  /// For each run of kBlock indices the version at which one of them changed last.
  const std::vector<std::uint64_t>& block_versions() const { return block_versions_; }

 private:
  void build(const Asset& asset);
  void grow_to(std::uint32_t N, std::vector<std::uint32_t>& triangles);
  void shrink_to(std::uint32_t N, std::vector<std::uint32_t>& triangles);
  void mark(std::size_t slot);
  std::span<const std::uint32_t> slots_of(std::uint32_t vertex) const;

  std::uint32_t base_ = 0, rows_ = 0, level_ = 0;
  std::vector<std::uint32_t> map_;                   ///< As of the asset.
  std::vector<std::array<std::uint32_t, 3>> faces_;  ///< Likewise.
  std::vector<std::uint32_t> death_;                 ///< Likewise.
  /// Indices (3 x face + corner) that are this vertex while it is the newest, and map[vertex] without it.
  std::vector<std::uint32_t> slots_, first_slot_;
  std::vector<std::uint64_t> block_versions_;
  std::uint64_t version_ = 0;
};

}  // namespace eigencast
