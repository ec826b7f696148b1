// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/surface/motion_clip.h"
#include "sdk/bake.h"
#include "sender/deform/deformer.h"

namespace eigencast {

struct CageOptions {
  std::string file;                   ///< Empty: one is made.
  int resolution = 5;                 ///< See deform::cage_around.
  std::string coordinates = "green";  ///< green, mean-value
};

struct SourceOptions {
  std::string input;          ///< Name of a built-in shape, or a path, directory or glob.
  std::string rest;           ///< File of the rest pose (default: the first frame).
  std::string faces;          ///< faces.npy of a .npy clip (default: the one beside it).
  std::string animation;      ///< Picks one of a glTF file by name or number (default: the first).
  double sample_rate_hz = 0;  ///< Samples formats that state curves instead of poses; 0: 30, a recording's own.
  BasisKind basis = BasisKind::kAugmented;
  EigenSolver solver = EigenSolver::kLanczos;  ///< Solves augmented and harmonic bases.
  int rank = 0;  ///< 0: by the wish; without one 200, of pca 50, of rig and cage all columns that there are.
  // Wishes, see BakeWish; the first that is not 0 holds, where no rank is named.
  double target_error = 0, quality = 0, bitrate_kbit = 0;
  std::string poses;                  ///< Clip that bases are judged by (default: the input).
  std::optional<double> asset_error;  ///< See BakeOptions (default: 1e-4; of rig and cage, which are exact, 0).
  PointsOperator points_operator = PointsOperator::kLocalDelaunay;  ///< See BakeOptions.
  bool delaunay = false;                                            ///< Likewise.
  std::string detail;                                               ///< See DetailKind; empty: as BakeOptions says.
  CageOptions cage;                                                 ///< Builds the basis cage.
  std::string name;  ///< (default: the built-in's, or the file's or folder's without its path: assets are public)
  std::string cache_dir;
  bool waits = false;      ///< For the whole bake, instead of beginning with a part (GrowingBake).
  bool any_order = false;  ///< Take poses whose vertices certainly are in another order than the faces'.
};

/// Null: nothing is open.
struct OpenedSource {
  std::unique_ptr<MotionClip> clip = {};
  const deform::Deformer* cage =
      nullptr;  ///< The model bound to the cage of the same options. Needed until it is baked.
};

struct Source {
  std::unique_ptr<MotionClip> clip;
  BakeResult baked;
  std::vector<std::string> findings = {};  ///< Suspicious things about the mesh or its poses, a line each.
};

/// A path that exists, or a glob, wins over a built-in name. Errors: those of builtin_clip and open_clip.
Result<std::unique_ptr<MotionClip>> open_source(const SourceOptions& options);

/// Read, or made around the model. Errors: those of read_surface, deform::cage_from_mesh and cage_around.
Result<Surface> cage_of(const CageOptions& options, const Surface& model);
Result<std::unique_ptr<deform::Deformer>> bind_cage(const CageOptions& options, const Surface& model, Surface cage,
                                                    const std::function<bool(double)>& progress);

KnownMotion motion_of_cage(const deform::Deformer& cage);

/// Errors: kInvalidArgument (rig, pca: the clip lacks what they are made of), saying what else would do.
Result<void> check_basis(BasisKind basis, const MotionClip& clip);

/// Errors: those of open_source, check_basis, cage_of, bind_cage and bake; kInvalidArgument (the mesh, or most of a few
/// poses of the clip, or of options.poses, certainly are in another order of vertices than the faces).
Result<Source> bake_source(const SourceOptions& options, const BakeProgress& progress, OpenedSource opened = {});
/// The same of a clip that is open, which nothing uses meanwhile, before `first` is called.
Result<BakeResult> bake_clip(const SourceOptions& options, const OpenedSource& opened, const BakeProgress& progress,
                             std::vector<std::string>& findings, std::function<void(BakeResult&)> first = {});

}  // namespace eigencast
