// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "common/asset/asset.h"
#include "common/asset/detail.h"
#include "common/asset/format/encode.h"
#include "common/spectral/basis_options.h"
#include "common/spectral/known_motion.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"
#include "sdk/rank_trial.h"

namespace eigencast {

struct BakeResult;

/// Of the asset to begin a stream with.
inline constexpr int kFirstRank = 54;

struct BakeOptions {
  BasisKind basis = BasisKind::kAugmented;
  int rank = 200;    ///< r (default: 200), without a wish.
  std::string name;  ///< Names the surface to people.
  /// What rounding the basis may move a vertex by (rms, of the diagonal) in a motion as large as those of animations.
  /// 0: columns of 32-bit floats, an asset five to ten times as large.
  double asset_error = 1e-4;
  /// What rig, cage (of its columns) and pca (of its poses) are made of (`rank` is the most that they may have), and
  /// poses that the levels of detail of a mesh are to look like; null: none. Must outlive the bake.
  const KnownMotion* motion = nullptr;
  /// Moves the same surface; null: none. Needed until bake() returns.
  const Appearance* appearance = nullptr;
  PointsOperator points_operator = PointsOperator::kLocalDelaunay;  ///< Applies to point clouds.
  /// How what a harmonic or pca basis leaves out of the rest pose comes back (default: frames for harmonic, else none).
  /// An asset two to three times as large, whose poses take viewers three times the multiplications.
  std::optional<DetailKind> detail = std::nullopt;
  /// Meshes take the operator of LaplacianOptions::delaunay, whether its edges ask for it or not.
  bool delaunay = false;
  EigenSolver solver = EigenSolver::kLanczos;  ///< Solves augmented and harmonic bases.
  /// Chooses r, the groups of products and the coding by a trial on sample poses: `samples`, else `motion`, else
  /// deformations of the rest pose. Up to 300 columns; 512 for an error that these do not reach.
  std::optional<BakeWish> wish = std::nullopt;
  const KnownMotion* samples = nullptr;  ///< Must outlive the bake.
  /// Called once with an asset of kFirstRank columns, made in a fraction of the time, to stream with until the whole is
  /// there: its levels are the same. Not where that is in the cache, or as small; nor with detail, nor of a motion's
  /// bases. May take the result.
  std::function<void(BakeResult& first)> first{};
};
DetailKind detail_of(const BakeOptions& options);

/// Called as in spectral/eigenbasis.h: fraction in [0, 1], what is being done; returns false to cancel.
using BakeProgress = std::function<bool(double fraction, std::string_view stage)>;

struct BakeResult {
  Asset asset;  ///< As receivers will have it: decoded from `encoded`.
  EncodedAsset encoded;
  bool from_cache = false;
  bool certified = false;    ///< All eigenvectors are there, and are to the residual. (A motion's bases have none.)
  bool approximate = false;  ///< They are approximations, of a surface of more than 150,000 vertices.
  double residual = 0;
  std::optional<RankTrial> trial;  ///< Of a wish.
  /// Why it could not be kept in the cache, which the bake does without; empty: it was, or had not to be.
  std::string not_kept;
  std::string report;  ///< For people: what check_surface found, rank used, seconds taken.
};

/// Estimates bytes from above. More than there is, and bake() refuses.
double bake_bytes(std::size_t vertices, const BakeOptions& options);

/// With a cache directory (see asset_cache.h) the result is kept under the hash of the surface and the options, and
/// found there next time. Errors: kInvalidArgument, kNumerical, kCancelled, kTooLarge.
Result<BakeResult> bake(const Surface& surface, const BakeOptions& options, const std::string& cache_dir = {},
                        const BakeProgress& progress = {});

}  // namespace eigencast
