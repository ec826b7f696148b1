// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast {

/// The triangles of a changing level of detail: from N to N' only the faces of the vertices in between change. Going
/// there and back gives the same triangles. After Hoppe 1996, "Progressive Meshes". Follows an asset as it arrives.
/// Takes 4 bytes for each level at which a corner of a face changes. Not thread-safe.
class LevelTriangles {
 public:
  static constexpr std::size_t kBlock = 1024;  ///< Indices uploaded together.

  /// Takes new rows and faces and returns the triangles of the level, clamped to what has arrived; true if they may
  /// have changed. O(vertices + faces).
  bool update(const Asset& asset, std::vector<std::uint32_t>& triangles);
  /// Call it before following another asset.
  void forget() { rows_ = 0, faces_.clear(); }

  /// Goes to level N: changes `triangles`, unchanged since the last call, to those of triangles_at_level().
  /// REQUIRES: base_count <= N <= rows_ready of the last update().
  void set_level(std::uint32_t N, std::vector<std::uint32_t>& triangles);
  std::uint32_t level() const { return level_; }
  std::span<const std::uint32_t> map() const { return map_; }  ///< Asset::map of the arrived rows.
  /// The arrived faces, with corners among those rows.
  std::span<const Corners> faces() const { return faces_; }
  std::span<const std::uint32_t> death() const { return death_; }

  void mark_all() {
    std::fill(block_versions_.begin(), block_versions_.end(), ++version_);
  }                                                   ///< As if all had changed.
  std::uint64_t version() const { return version_; }  ///< Grows with every change.
  /// For each run of kBlock indices the version at which one of them changed last.
  const std::vector<std::uint64_t>& block_versions() const { return block_versions_; }

 private:
  void mark(std::size_t slot);
  std::span<const std::uint32_t> slots_of(std::uint32_t vertex) const {
    return {slots_.data() + first_slot_[vertex], slots_.data() + first_slot_[vertex + 1]};
  }

  std::uint32_t base_ = 0, rows_ = 0, level_ = 0;
  std::vector<std::uint32_t> map_, death_;  ///< Copies of the asset's.
  std::vector<Corners> faces_;
  /// Indices (3 x face + corner) that are this vertex while it is the newest, and map[vertex] below its level.
  std::vector<std::uint32_t> slots_, first_slot_;
  std::vector<std::uint64_t> block_versions_;
  std::uint64_t version_ = 0;
};

}  // namespace eigencast
