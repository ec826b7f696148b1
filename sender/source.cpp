// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <cstdio>
#include <filesystem>

#include "common/spectral/known_motion.h"
#include "common/surface/checks/jumps.h"
#include "common/surface/formats/clip.h"
#include "common/surface/formats/read.h"
#include "common/surface/shapes/shapes.h"
#include "common/wire/limits.h"
#include "sdk/recorded_clip.h"
#include "sender/deform/cage.h"
#include "sender/order_check.h"
#include "sender/recorded_motion.h"

namespace eigencast {
namespace {

constexpr double kMemoryWorthSaying = 1e9;  // bytes

/// Omits the path, which viewers should not learn.
std::string public_name(const std::string& clip_name) {
  const std::filesystem::path path(clip_name);
  const std::string stem = path.stem().string();
  // Generic file names and globs say nothing: their folder does.
  const bool generic = stem == "vertices" || stem.find_first_of("*?[") != std::string::npos || stem.empty();
  const std::string folder = path.parent_path().filename().string();
  return generic && !folder.empty() ? folder : stem;
}

int rank_of(const SourceOptions& options) {
  if (options.rank > 0) return options.rank;
  if (options.basis == BasisKind::kPca) return 50;
  return is_of_columns(options.basis) ? static_cast<int>(limits::kMaxRows) : 200;
}

/// Nothing: the rank is named, or what it is without a wish.
std::optional<BakeWish> wish_of(const SourceOptions& options) {
  if (options.rank > 0) return std::nullopt;
  if (options.target_error > 0) return BakeWish{1, options.target_error, 0};
  if (options.quality > 0) return BakeWish{options.quality, 0, 0};
  if (options.bitrate_kbit > 0) return BakeWish{1, 0, options.bitrate_kbit};
  return options.poses.empty() ? std::optional<BakeWish>() : BakeWish{};
}

/// The clip of options.poses, whose poses are in the mesh's order of vertices; null: none is named.
Result<std::unique_ptr<MotionClip>> open_poses(const SourceOptions& options, const Surface& mesh,
                                               std::string& finding) {
  if (options.poses.empty()) return std::unique_ptr<MotionClip>();
  constexpr std::size_t kChecked = 24;
  SourceOptions poses = options;
  poses.input = options.poses;
  poses.rest.clear();
  poses.faces.clear();
  auto clip = open_source(poses);
  if (!clip) return clip;
  auto misfit = check_frames(mesh, **clip, sample_frames((*clip)->frame_count(), kChecked), options.any_order);
  if (!misfit) return in_context(options.poses, misfit.error());
  finding = std::move(*misfit);
  return clip;
}

/// Refuses before the bake what the check of all poses would refuse after it.
Result<void> check_order(const MotionClip& clip, JumpFinder& mesh, bool any_order) {
  constexpr std::size_t kPoses = 5;
  for (const std::size_t frame : sample_frames(clip.frame_count(), kPoses)) {
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    if (pose->size() == clip.rest().vertex_count()) mesh.add(*pose);  // The projection reports the others.
  }
  return accept_order(mesh.order(), any_order);
}

}  // namespace

// Where the handles of a cage move by its size, its faces' normals turn and stretch by one: the columns are scaled so.
KnownMotion motion_of_cage(const deform::Deformer& cage) {
  const deform::LinearMap& map = *cage.linear_map();
  SpanningColumns columns{map.controls, map.W};
  const double size = bounding_box(cage.handles()).diagonal();
  for (std::size_t i = 0; i < map.vertices; ++i) {
    for (std::size_t handle = 0; handle < cage.handles().size(); ++handle) columns.W[i * map.controls + handle] *= size;
  }
  return {std::move(columns), 0, {}};
}

Result<Surface> cage_of(const CageOptions& options, const Surface& model) {
  if (options.file.empty()) return deform::cage_around(model, options.resolution);
  auto cage = read_surface(options.file);
  if (!cage) return cage;
  cage = deform::cage_from_mesh(std::move(*cage));
  return cage ? std::move(cage) : in_context(options.file, cage.error());
}

Result<std::unique_ptr<deform::Deformer>> bind_cage(const CageOptions& options, const Surface& model, Surface cage,
                                                    const std::function<bool(double)>& progress) {
  const bool green = options.coordinates == "green";
  return deform::cage_deformer(model, std::move(cage),
                               green ? deform::CageCoordinates::kGreen : deform::CageCoordinates::kMeanValue, progress);
}

Result<std::unique_ptr<MotionClip>> open_source(const SourceOptions& options) {
  // Neither a path, nor a glob, nor a file's name: a built-in shape is meant, and its error lists those that there are.
  std::error_code ignored;
  const bool is_word = options.input.find_first_of("/*?[.") == std::string::npos;
  if (is_word && !std::filesystem::exists(options.input, ignored)) return builtin_clip(options.input);
  if (is_recording(options.input))
    return open_recorded_motion(options.input, options.cache_dir, options.sample_rate_hz);
  ClipOptions clip{options.rest, options.faces, options.animation};
  if (options.sample_rate_hz > 0) clip.rate_hz = options.sample_rate_hz;
  return open_clip(options.input, clip);
}

Result<void> check_basis(BasisKind basis, const MotionClip& clip) {
  if (basis == BasisKind::kRig && clip.rig() == nullptr) {
    return fail(ErrorCode::kInvalidArgument,
                "it states no bones and no morph targets, which the basis rig is made of (glTF "
                "does); learn a basis from its poses with --basis pca");
  }
  if (basis == BasisKind::kPca && clip.frame_count() < 2) {
    return fail(
        ErrorCode::kInvalidArgument,
        "a basis is learned from the poses of a clip, and there is only one here: give a clip, or another basis");
  }
  return {};
}

Result<Source> bake_source(const SourceOptions& options, const BakeProgress& progress, OpenedSource opened) {
  if (opened.clip == nullptr) {
    if (const auto good = store(opened.clip, open_source(options)); !good) return good.error();
  }
  std::vector<std::string> findings;
  auto baked = bake_clip(options, opened, progress, findings);
  if (!baked) return baked.error();
  return Source{std::move(opened.clip), std::move(*baked), std::move(findings)};
}

Result<BakeResult> bake_clip(const SourceOptions& options, const OpenedSource& opened, const BakeProgress& progress,
                             std::vector<std::string>& findings, std::function<void(BakeResult&)> first) {
  const std::unique_ptr<MotionClip>& clip = opened.clip;
  if (const auto usable = check_basis(options.basis, *clip); !usable) return in_context(options.input, usable.error());
  const Surface& rest = clip->rest();
  JumpFinder mesh(rest);
  if (const auto accepted = check_order(*clip, mesh, options.any_order); !accepted)
    return in_context(options.input, accepted.error());
  std::string finding;
  const auto poses = open_poses(options, rest, finding);
  if (!poses) return poses.error();
  const MotionClip& samples = *poses != nullptr ? **poses : *clip;
  const KnownMotion judges = motion_of(samples);
  KnownMotion motion;
  if (options.basis == BasisKind::kRig) {
    auto columns = columns_from_rig(*clip->rig());
    if (!columns) return in_context(options.input, columns.error());
    motion = motion_of(*clip, std::move(*columns));
  } else if (options.basis == BasisKind::kCage && opened.cage != nullptr) {
    motion = motion_of_cage(*opened.cage);
  } else if (options.basis == BasisKind::kCage) {
    auto cage = cage_of(options.cage, rest);
    if (!cage) return in_context(options.input, cage.error());
    const auto bound = bind_cage(options.cage, rest, std::move(*cage),
                                 [&](double) { return !progress || progress(0, "binding the model to its cage"); });
    if (!bound) return in_context(options.input, bound.error());
    motion = motion_of_cage(**bound);
  } else {
    motion = motion_of(*clip);
  }
  BakeOptions bake_options{options.basis,
                           rank_of(options),
                           options.name.empty() ? public_name(clip->name()) : options.name,
                           options.asset_error.value_or(is_of_columns(options.basis) ? 0 : 1e-4),
                           &motion,
                           clip->appearance(),
                           options.points_operator};
  bake_options.delaunay = options.delaunay;
  bake_options.solver = options.solver;
  bake_options.wish = wish_of(options);
  bake_options.samples = &judges;
  for (const std::string& line : {mesh.rest_finding(), finding}) {
    if (!line.empty()) findings.push_back(line);
  }
  bake_options.first = std::move(first);
  if (!options.detail.empty()) {
    const auto detail = detail_from_name(options.detail);
    if (!detail) return detail.error();
    bake_options.detail = *detail;
  }
  if (const double bytes = bake_bytes(rest.vertex_count(), bake_options); bytes >= kMemoryWorthSaying) {
    std::fprintf(stderr, "%zu vertices take about %.1f GB of memory to bake, unless that was done before\n",
                 rest.vertex_count(), bytes / 1e9);
  }
  auto baked = bake(rest, bake_options, options.cache_dir, progress);
  return baked ? std::move(baked) : in_context(options.input, baked.error());
}

}  // namespace eigencast
