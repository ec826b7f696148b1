// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "common/asset/texture.h"

namespace eigencast {

class LevelMorph;
struct SurfaceGeometry;

/// Values of which runs of kBlock are handed on together, each with the version at which one of them changed last.
template <typename T>
struct VersionedBlocks {
  static constexpr std::size_t kBlock = 1024;
  std::vector<T> values;
  std::vector<std::uint64_t> versions;

  void resize(std::size_t count) {
    values.resize(count);
    versions.resize((count + kBlock - 1) / kBlock);
  }
  void set(std::size_t i, const T& value, std::uint64_t version) {
    values[i] = value;
    versions[i / kBlock] = version;
  }
};

/// Which wedge each corner of the triangles that are drawn has, and where wedges lie in the image, while the level
/// moves: at the cost of the move, and without a jump (places go over as LevelMorph lets the vertices do).
///
/// Not thread-safe.
class TextureLevels {
 public:
  /// uv of a wedge that is not in the image.
  static constexpr float kNone = -std::numeric_limits<float>::max();

  /// Takes over what has changed since the last call. REQUIRES: the geometry and morph of one surface, that of the
  /// texture.
  void follow(std::shared_ptr<const AssetTexture> texture, const SurfaceGeometry& geometry, const LevelMorph& morph);

  const VersionedBlocks<std::uint32_t>& corners() const { return corners_; }       ///< As SurfaceGeometry::triangles.
  const VersionedBlocks<std::array<float, 2>>& places() const { return places_; }  ///< Of the wedges in use, uv.
  std::uint64_t version() const { return version_; }  ///< Grows with each call, in all of them.

 private:
  void place_wedges(std::uint32_t from_vertex, const LevelMorph& morph);
  std::uint32_t vertex_count() const { return static_cast<std::uint32_t>(texture_->first_wedge.size()) - 1; }

  std::shared_ptr<const AssetTexture> texture_;
  std::uint64_t maker_ = 0, topology_version_ = 0, version_ = 0;
  std::uint32_t whole_ = 0, drawn_ = 0;
  VersionedBlocks<std::uint32_t> corners_;
  VersionedBlocks<std::array<float, 2>> places_;
};

}  // namespace eigencast
