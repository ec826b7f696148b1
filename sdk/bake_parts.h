// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/detail.h"
#include "common/asset/format/encode.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"
#include "common/progressive/wedges.h"
#include "common/spectral/basis.h"
#include "common/spectral/laplacian.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"
#include "sdk/asset_cache.h"
#include "sdk/bake.h"

/// What bake() is put together from, in a file each: bake_detail.cpp, bake_levels.cpp, bake_record.cpp,
/// bake_report.cpp, bake_texture.cpp.
namespace eigencast {

/// What the asset's basis leaves out of the rest pose.
///   asset    as it is to be encoded: complete, without detail
///   surface  its source
///   normals  of a point cloud, in the source's order; empty for meshes, whose faces give them
///   encoding of the asset: rounding derivatives moves vertices by no more than rounding the basis does
/// REQUIRES: kind is not kNone.
Asset::Detail detail_from(DetailKind kind, const Asset& asset, const Surface& surface, std::span<const Vec3> normals,
                          const AssetEncoding& encoding);

/// The errors of 16 levels from the base up (AssetFacts::level_errors). Of a mesh, at up to 4,096 vertices of
/// each pose, the mean at 512.
///   asset  complete, its rows in the order of levels
///   poses  of a mesh beside the rest pose, n each, in the source's order
/// Empty for a cloud without discs.
std::vector<GeometricError> level_errors_of(const Asset& asset, const Surface& surface,
                                            std::span<const std::vector<Vec3>> poses);

/// What was baked before under `key`, for `wish`, whole and verified.
std::optional<BakeResult> load_bake(const AssetCache& cache, const Sha256& key, const std::optional<BakeWish>& wish);

/// Chooses the coding again with the basis as the asset has it, rounded: what is chosen then is the last point.
///   asset  complete, of the trial's rank
void settle_coding(RankTrial& trial, const Asset& asset, const Laplacian& laplacian, const SamplePoses& poses);

Result<void> store_bake(const AssetCache& cache, const Sha256& key, const BakeResult& result);

/// Where and how the surface of the bake lies under `key`, for load_moved().
///   shape  hashes what else the bake was made of
Result<void> store_place(const AssetCache& cache, const Sha256& shape, const Sha256& key, const Surface& surface);
/// What was baked last under `shape`, if `surface` is that one turned and shifted: with its rest pose there. Its bytes
/// are another manifest over the same chunks.
std::optional<BakeResult> load_moved(const AssetCache& cache, const Sha256& shape, const Surface& surface);

struct BakeFacts {
  const Surface& surface;
  std::size_t poses;  ///< That its levels of detail were made for, beside the rest pose.
  const BakeOptions& options;
  const Laplacian& laplacian;
  const Basis& basis;
  double seconds;
  double bytes;  ///< Measures memory.
};

std::string report_of(const BakeResult& result, const BakeFacts& facts);

/// The image that an asset is to have, and where the corners of the source's faces lie in it.
struct TexturePlan {
  std::array<float, 2> low{}, high{};
  std::vector<CornerUvs> uvs;  ///< A face each.
  Bytes image;
};

/// Picks the image that most faces have; nothing where there is none that an asset can have. `report`
/// gets lines for people: which it is, and what was left out and why.
std::optional<TexturePlan> plan_texture(const Surface& surface, const Appearance& appearance, std::string& report);

/// REQUIRES: the order is of the plan's surface.
std::shared_ptr<const AssetTexture> texture_along(const PrefixOrder& order, const TexturePlan& plan);

}  // namespace eigencast
