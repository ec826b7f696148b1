// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast {

class LevelMorph;
struct SurfaceGeometry;

/// Each block has the version of its last change.
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

/// The wedge of each corner of the drawn triangles, and the wedges' UVs, morphed. Updates cost as much as the level has
/// changed. Not thread-safe.
class TextureLevels {
 public:
  /// UV of a wedge outside the image.
  static constexpr float kNone = -std::numeric_limits<float>::max();

  /// REQUIRES: geometry and morph belong to the texture's surface.
  void follow(std::shared_ptr<const AssetTexture> texture, const SurfaceGeometry& geometry, const LevelMorph& morph);

  const VersionedBlocks<std::uint32_t>& corners() const { return corners_; }  ///< As SurfaceGeometry::triangles.
  const VersionedBlocks<std::array<float, 2>>& uvs() const { return uvs_; }   ///< For the wedges in use.
  std::uint64_t version() const { return version_; }  ///< Grows with each follow() of any object.

 private:
  void set_wedges(std::uint32_t from_vertex, const LevelMorph& morph);
  std::uint32_t vertex_count() const { return static_cast<std::uint32_t>(texture_->first_wedge.size()) - 1; }

  std::shared_ptr<const AssetTexture> texture_;
  std::uint64_t maker_ = 0, topology_version_ = 0, version_ = 0;
  std::uint32_t whole_ = 0, drawn_ = 0;
  VersionedBlocks<std::uint32_t> corners_;
  VersionedBlocks<std::array<float, 2>> uvs_;
};

}  // namespace eigencast
