// SPDX-License-Identifier: MIT
#include "sdk/bake.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <future>
#include <new>
#include <optional>
#include <span>
#include <system_error>
#include <utility>
#include <vector>

#include "common/asset/format/reader.h"
#include "common/codec/key.h"
#include "common/core/clock.h"
#include "common/core/machine.h"
#include "common/core/text.h"
#include "common/core/worker_team.h"
#include "common/progressive/point_normals.h"
#include "common/progressive/prefix.h"
#include "common/progressive/splats.h"
#include "common/spectral/basis.h"
#include "common/spectral/eigenbasis.h"
#include "common/spectral/laplacian.h"
#include "common/surface/appearance.h"
#include "common/surface/checks/orientation.h"
#include "common/surface/vector.h"
#include "common/wire/limits.h"
#include "sdk/asset_cache.h"
#include "sdk/bake_parts.h"
#include "sdk/rank_trial.h"

namespace eigencast {
namespace {

/// Grows with every change of what a bake gives for the same input, so that old results are not found again.
constexpr std::uint32_t kRecipe = 12;
// Across a surface, so that its masses and a basis over them are numbers of 32 bits.
constexpr double kMinSize = 1e-15, kMaxSize = 1e15;

constexpr std::size_t kPosesOfLevels = 6;             // more change little
constexpr std::size_t kMaxPosedVertices = 1'200'000;  // of all those poses: 100 bytes each
// Columns that a trial chooses from, and for errors that these do not reach; of surfaces of millions as without one.
constexpr int kTrialRank = 300, kLastRank = 512, kRankOfMillions = 200;
constexpr std::size_t kTrialVertices = 300'000;
constexpr double kTrialBytes = 16'000;  // of each vertex that it judges by
constexpr double kProgramBytes = 35e6;
constexpr double kKernelBytes =
    12'000;  // of a point: the heat kernel's pairs, matrix and factor; 9 KB at 42,000 points

// Where each stage ends, as a fraction of the whole.
constexpr double kLaplacianDone = 0.03;
constexpr double kBasisDone = 0.85;
constexpr double kOrderDone = 0.93;

/// Poses from all over a motion; one that cannot be read, or is not finite, is left out: playing it reports that.
std::vector<std::vector<Vec3>> poses_of_levels(const Surface& surface, const KnownMotion* motion) {
  std::vector<std::vector<Vec3>> poses;
  if (motion == nullptr || motion->poses < 2 || surface.is_point_cloud()) return poses;
  const std::size_t count =
      std::min({kPosesOfLevels, motion->poses, kMaxPosedVertices / std::max<std::size_t>(surface.vertex_count(), 1)});
  for (std::size_t i = 0; i < count; ++i) {
    auto pose = motion->pose((2 * i + 1) * motion->poses / (2 * count));
    if (!pose || pose->size() != surface.vertex_count()) continue;
    const bool finite = std::all_of(pose->begin(), pose->end(), [](const Vec3& p) {
      return std::all_of(p.begin(), p.end(), [](double x) { return std::isfinite(x); });
    });
    if (finite) poses.push_back(std::move(*pose));
  }
  return poses;
}

struct PlannedAppearance {
  std::vector<std::array<std::uint8_t, 3>> colours;
  std::vector<std::uint8_t> normals;  // as the asset has them
  std::optional<TexturePlan> texture;
  std::string report;
};

/// turned: faces of the surface that are to be turned.
PlannedAppearance planned_appearance(const Surface& surface, const std::vector<bool>& turned,
                                     const Appearance* stated) {
  PlannedAppearance appearance;
  if (const auto count = std::count(turned.begin(), turned.end(), true); count > 0)
    appearance.report =
        formatted("orientation: %td of %zu faces turned, since neighbours contradicted\n", count, turned.size());
  if (stated == nullptr) return appearance;
  appearance.colours = stated_colours(surface, *stated);
  if (stated->vertex_normals.size() == surface.vertex_count() && !surface.is_point_cloud())
    for (const VertexNormals own : stated->vertex_normals) appearance.normals.push_back(static_cast<std::uint8_t>(own));
  appearance.texture = plan_texture(surface, *stated, appearance.report);
  if (appearance.texture) turn_faces(turned, appearance.texture->uvs);
  return appearance;
}

bool uses_kernel(const BakeOptions& options) {
  return options.points_operator == PointsOperator::kPbMhb;
}

std::string_view operator_of(const Surface& surface, const Laplacian& laplacian, const BakeOptions& options) {
  if (surface.is_point_cloud()) return kPointsOperatorNames[options.points_operator];
  return laplacian.flips ? "tufted" : "cotangent";
}

Result<void> check_basis(const BakeOptions& options) {
  if (!is_of_motion(options.basis)) return {};
  const bool has_columns = options.motion != nullptr && options.motion->columns.count > 0;
  if (options.motion != nullptr && has_columns == is_of_columns(options.basis)) return {};
  return fail(ErrorCode::kInvalidArgument,
              "a '" + std::string(name_of(options.basis)) + "' basis is made of a motion's " +
                  (is_of_columns(options.basis) ? "columns" : "poses") + ", which are not given");
}

Result<void> check_points_operator(const Surface& surface, const BakeOptions& options) {
  if (!uses_kernel(options) || surface.is_point_cloud()) return {};
  return fail(ErrorCode::kInvalidArgument,
              "'pb-mhb' is an operator of point clouds, and this surface has faces, which say more than it would find: "
              "leave the option out, or the faces");
}

Result<void> check_detail(const BakeOptions& options) {
  if (detail_of(options) == DetailKind::kNone || leaves_detail(options.basis)) return {};
  return fail(ErrorCode::kInvalidArgument, "detail '" + std::string(name_of(*options.detail)) + "' of a basis '" +
                                               std::string(name_of(options.basis)) +
                                               "', which holds the rest pose as it is: leave the option out, or take "
                                               "the basis 'harmonic'");
}

Result<void> check_wish(const BakeOptions& options) {
  if (!options.wish) return {};
  const auto& [quality, error, kbit_per_s] = *options.wish;
  if (!(quality > 0 && error >= 0 && kbit_per_s >= 0 && std::isfinite(quality + error + kbit_per_s)))
    return fail(ErrorCode::kInvalidArgument, "a quality, target error or bit rate that is not a number above 0");
  if (detail_of(options) == DetailKind::kNone) return {};
  return fail(ErrorCode::kInvalidArgument,
              "a rank is chosen by what the basis alone shows, without detail: name the rank, or take no detail");
}

/// So many columns that a trial has a choice, but what memory there is holds.
int trial_rank(std::size_t vertices, BakeOptions options) {
  if (is_of_columns(options.basis)) return static_cast<int>(limits::kMaxRows);
  if (vertices > kTrialVertices) return kRankOfMillions;
  options.rank = kTrialRank;
  while (options.rank > kRankOfMillions && bake_bytes(vertices, options) > usable_memory()) options.rank -= 50;
  return options.rank;
}

Result<void> check_options(const Surface& surface, const BakeOptions& options) {
  if (auto wish = check_wish(options); !wish) return wish;
  if (auto basis = check_basis(options); !basis) return basis;
  if (auto points = check_points_operator(surface, options); !points) return points;
  if (auto detail = check_detail(options); !detail) return detail;
  if (options.rank < 1 || options.rank > static_cast<int>(limits::kMaxRows)) {
    return fail(ErrorCode::kInvalidArgument, "a rank of " + std::to_string(options.rank) + ": use 1 to " +
                                                 std::to_string(limits::kMaxRows) + ", 200 does for most surfaces");
  }
  if (!(options.asset_error >= 0 && options.asset_error <= 0.1)) {
    return fail(ErrorCode::kInvalidArgument, "an asset error that is not between 0 and 0.1 of the diagonal");
  }
  const double size = bounding_box(surface.positions).diagonal();
  if (size > 0 && !(size >= kMinSize && size <= kMaxSize)) {
    return fail(ErrorCode::kInvalidArgument,
                formatted("the surface is %.1g units across; assets and streams hold %.0e to %.0e: choose another unit",
                          size, kMinSize, kMaxSize));
  }
  const double needed = bake_bytes(surface.vertex_count(), options);
  if (const double there = usable_memory(); needed > there) {
    return fail(
        ErrorCode::kTooLarge,
        formatted(
            "baking %zu vertices at rank %d needs about %.1f GB of memory, %.1f GB are free here: lower the rank, "
            "simplify the surface, or end what else takes memory",
            surface.vertex_count(), options.rank, needed / 1e9, there / 1e9));
  }
  return {};
}

/// Errors: those of the motion's poses.
Result<Sha256> key_of(const Surface& surface, std::span<const std::vector<Vec3>> poses,
                      const PlannedAppearance& appearance, const BakeOptions& options, const SamplePoses* samples) {
  Bytes head;
  ByteWriter out(head);
  out.text("eigencast bake");
  out.u32(kRecipe);
  out.varint(name_of(options.basis).size());
  out.text(name_of(options.basis));
  out.varint(options.name.size());
  out.text(options.name);
  out.u32(static_cast<std::uint32_t>(options.rank));
  out.f64(options.asset_error);
  if (uses_kernel(options)) out.text(kPointsOperatorNames[options.points_operator]);
  out.u8(static_cast<std::uint8_t>(detail_of(options)));
  out.u8(options.delaunay ? 1 : 0);
  if (options.solver != EigenSolver::kLanczos) out.text(kSolverNames[options.solver]);
  out.u64(surface.positions.size());
  out.u64(surface.faces.size());
  if (samples != nullptr) {
    const auto& [quality, error, kbit_per_s] = *options.wish;
    for (const double value : {quality, error, kbit_per_s, samples->rate_hz}) out.f64(value);
    for (const std::size_t end : samples->run_ends) out.u64(end);
  }
  Sha256Stream stream;
  stream.update(head);
  const auto view = [](const auto& values) {
    return ByteView(reinterpret_cast<const std::uint8_t*>(values.data()), values.size() * sizeof(values[0]));
  };
  stream.update(view(surface.positions));
  stream.update(view(surface.faces));
  for (const auto& pose : poses) stream.update(view(pose));
  if (samples != nullptr)
    stream.update({reinterpret_cast<const std::uint8_t*>(samples->positions.data()),
                   static_cast<std::size_t>(samples->positions.size()) * sizeof(double)});
  if (!appearance.colours.empty()) stream.update(view(appearance.colours));
  if (!appearance.normals.empty()) stream.update(view(appearance.normals));
  if (appearance.texture) {
    stream.update(view(appearance.texture->low));
    stream.update(view(appearance.texture->high));
    stream.update(view(appearance.texture->uvs));
    stream.update(appearance.texture->image);
  }
  if (is_of_motion(options.basis)) {
    const KnownMotion& motion = *options.motion;
    stream.update(view(motion.columns.W));
    for (std::size_t i = 0; i < motion.samples(); ++i) {
      const auto pose = motion.sample(i);
      if (!pose) return pose.error();
      stream.update(view(*pose));
    }
  }
  return stream.finish();
}

Vec3 centroid_of(const Surface& surface, const Eigen::VectorXd& mass, double area) {
  Vec3 sum{};
  for (std::size_t i = 0; i < surface.positions.size(); ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      sum[axis] += mass[static_cast<Eigen::Index>(i)] * surface.positions[i][axis];
    }
  }
  for (double& value : sum) value /= area;
  return sum;
}

std::vector<double> rest_coefficients(const Surface& surface, const Basis& basis, const Vec3& origin) {
  std::vector<Vec3> centred = surface.positions;
  for (Vec3& p : centred) p = p - origin;
  const Eigen::MatrixXd C = coefficients_from_positions(basis, centred);
  // The rest pose lies in the first columns of an augmented basis; the others hold rounding.
  const double rounding = 1e-12 * C.cwiseAbs().maxCoeff();
  std::vector<double> rest(static_cast<std::size_t>(C.size()));
  for (Eigen::Index k = 0; k < C.rows(); ++k) {
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      const double value = C(k, axis);
      rest[static_cast<std::size_t>(3 * k + axis)] = std::abs(value) > rounding ? value : 0;
    }
  }
  return rest;
}

/// Psi with its rows in an order of the vertices, row-major. As many columns at a time as fill a cache line of the
/// result: rows that are far apart are visited once for all of them.
std::vector<float> rows_in_order(const Eigen::MatrixXd& Psi, std::span<const std::uint32_t> order) {
  constexpr std::size_t kColumns = 16;
  const auto r = static_cast<std::size_t>(Psi.cols());
  std::vector<std::size_t> row_of(order.size());
  for (std::size_t row = 0; row < order.size(); ++row) row_of[order[row]] = row;
  std::vector<float> rows(order.size() * r);
  for_shares(r, kColumns, [&](std::size_t first, std::size_t end) {
    for (std::size_t source = 0; source < row_of.size(); ++source) {
      for (std::size_t k = first; k < end; ++k) {
        rows[row_of[source] * r + k] =
            static_cast<float>(Psi(static_cast<Eigen::Index>(source), static_cast<Eigen::Index>(k)));
      }
    }
  });
  return rows;
}

/// REQUIRES: the appearance, the normals (of points), the basis and the order are of this surface.
Asset asset_from(const Surface& surface, const PlannedAppearance& appearance, std::span<const Vec3> normals,
                 const Basis& basis, PrefixOrder order, const BakeOptions& options) {
  Asset asset;
  const std::size_t n = surface.vertex_count();
  const auto r = static_cast<std::size_t>(basis.Psi.cols());
  asset.vertex_count = static_cast<std::uint32_t>(n);
  asset.rank = static_cast<std::uint32_t>(r);
  asset.base_count = order.base_count;
  asset.basis_kind = name_of(options.basis);
  asset.name = options.name;
  asset.band_ends = default_band_ends(asset.rank);
  asset.floats = rows_in_order(basis.Psi, order.order);
  asset.mass.resize(n);
  for (std::size_t row = 0; row < n; ++row) asset.mass[row] = static_cast<float>(basis.mass[order.order[row]]);
  asset.area = basis.area;
  asset.origin = centroid_of(surface, basis.mass, basis.area);
  asset.rest = rest_coefficients(surface, basis, asset.origin);
  const Box box = bounding_box(surface.positions);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    asset.box_low[axis] = box.low[axis] - asset.origin[axis];
    asset.box_high[axis] = box.high[axis] - asset.origin[axis];
  }
  if (surface.is_point_cloud()) {
    PointSplats splats = build_splats(surface.positions, normals, order);
    asset.splats = {std::move(splats.frame), std::move(splats.normal), std::move(splats.radius),
                    std::move(splats.parent_radius)};
  }
  if (!appearance.colours.empty()) {
    for (const std::uint32_t source : order.order) asset.colours.push_back(appearance.colours[source]);
  }
  if (!appearance.normals.empty()) {
    for (const std::uint32_t source : order.order) asset.normals.push_back(appearance.normals[source]);
  }
  if (appearance.texture) asset.texture = texture_along(order, *appearance.texture);
  asset.map = std::move(order.map);
  asset.faces = std::move(order.faces);
  asset.death = std::move(order.death);
  asset.source_vertex = std::move(order.order);
  asset.face_total = static_cast<std::uint32_t>(asset.faces.size());
  asset.rows_ready = asset.vertex_count;
  asset.faces_ready = asset.face_total;
  return asset;
}

/// Hashes what a bake is made of but where its surface lies; nothing: its chunks depend on that, too.
std::optional<Sha256> shape_of(const Surface& surface, const PlannedAppearance& appearance,
                               const BakeOptions& options) {
  if (surface.is_point_cloud() || options.basis != BasisKind::kAugmented || options.wish || options.motion != nullptr ||
      detail_of(options) != DetailKind::kNone)
    return std::nullopt;
  const Surface nowhere{std::vector<Vec3>(surface.vertex_count()), surface.faces};
  const auto key = key_of(nowhere, {}, appearance, options, nullptr);
  return key ? std::optional(*key) : std::nullopt;
}

/// In clips of people, animals and faces coefficient k (from 1) never was larger than 0.3 k^-1.2 diagonal sqrt(area)
/// beyond the affine ones, and mostly half that. What a learned basis meets is known: twice the root mean square, or as
/// much as leaves a column steps of an eighth of its entries: columns stay independent.
AssetEncoding encoding_of(const Asset& asset, const Basis& basis, const BakeOptions& options) {
  AssetEncoding encoding;
  if (options.asset_error == 0) {
    encoding.exact_columns = asset.rank;
    return encoding;
  }
  encoding.error = options.asset_error * asset.diagonal();
  const double least = 8 * encoding.error * std::sqrt(12 * asset.area / asset.rank);
  for (std::uint32_t k = 0; k < asset.rank; ++k) {
    const double* rest = &asset.rest[std::size_t{3} * k];
    const double moving = options.basis == BasisKind::kPca
                              ? std::max(2 * basis.rms[k], least)
                              : 0.2 * std::pow(k + 1.0, -1.2) * asset.diagonal() * std::sqrt(asset.area);
    encoding.amplitudes.push_back(std::max(moving, 1.5 * std::hypot(rest[0], rest[1], rest[2])));
  }
  return encoding;
}

class Stages {
 public:
  explicit Stages(const BakeProgress& progress) : progress_(progress) {}
  bool at(double fraction, std::string_view stage) const { return !progress_ || progress_(fraction, stage); }
  Progress within(double from, double to) const {
    return
        [this, from, to](double fraction, std::string_view stage) { return at(from + (to - from) * fraction, stage); };
  }

 private:
  const BakeProgress& progress_;
};

Error cancelled(std::string_view stage) {
  return fail(ErrorCode::kCancelled, "baking was stopped before its stage '" + std::string(stage) + "'");
}

/// Levels of detail need nothing of the basis, whose solver leaves a processor idle now and then: a thread of their
/// own finds them. Where no thread is available, the first request does.
class OrderToCome {
 public:
  OrderToCome(const Surface& surface, std::span<const std::vector<Vec3>> poses, const PlannedAppearance& appearance) {
    const auto work = [&surface, poses, &appearance, this] {
      std::vector<std::pair<std::uint32_t, std::uint32_t>> seams;
      if (appearance.texture) seams = seam_edges(surface.faces, appearance.texture->uvs);
      return build_prefix_order(surface, seams, poses, unwanted_);
    };
    try {
      order_ = std::async(std::launch::async, work);
    } catch (const std::system_error&) {
      order_ = std::async(std::launch::deferred, work);
    }
  }
  OrderToCome(const OrderToCome&) = delete;
  OrderToCome& operator=(const OrderToCome&) = delete;
  ~OrderToCome() { unwanted_ = true; }  // whereupon the future waits for its thread

  bool is_there_within(std::chrono::milliseconds time) const {
    return order_.wait_for(time) != std::future_status::timeout;
  }
  Result<PrefixOrder> take() { return order_.get(); }

 private:
  std::atomic<bool> unwanted_ = false;
  std::future<Result<PrefixOrder>> order_;
};

Result<Basis> basis_of(const Surface& surface, const Laplacian& laplacian, const BakeOptions& options,
                       const BasisTrial* trial, const Progress& progress) {
  if (!is_of_motion(options.basis))
    return build_basis(surface, laplacian, {options.basis, options.rank, options.solver}, progress, trial);
  auto basis = build_motion_basis(surface, laplacian, *options.motion, options.rank, progress);
  if (!basis || trial == nullptr) return basis;
  const auto cut = cut_by_trial(*basis, *trial);
  return cut ? std::move(basis) : cut.error();
}

/// What has fewer vertices is whole within a second or so.
constexpr std::size_t kLeastFirst = 4000;

bool goes_first(std::size_t vertices, const BakeOptions& options) {
  return options.first && vertices > kLeastFirst && options.basis == BasisKind::kAugmented &&
         detail_of(options) == DetailKind::kNone && (options.rank > kFirstRank || options.wish);
}

/// samples: of a wish, else null.
Result<BakeResult> bake_afresh(const Surface& surface, std::span<const std::vector<Vec3>> poses,
                               const PlannedAppearance& appearance, BakeOptions options, const SamplePoses* samples,
                               const Stages& stages) {
  const TimeUs start = steady_now_us();
  BakeResult result;
  if (!stages.at(0.01, "operator")) return cancelled("operator");
  OrderToCome order_to_come(surface, poses, appearance);
  auto laplacian = build_laplacian(surface, {.delaunay = options.delaunay, .points = options.points_operator});
  if (!laplacian) return laplacian.error();
  const auto normals = surface.is_point_cloud() ? oriented_normals(surface.positions) : std::vector<Vec3>();
  std::optional<PrefixOrder> order;
  const auto await_order = [&](double fraction) -> Result<void> {
    if (order) return {};
    do {
      if (!stages.at(fraction, "levels of detail")) return cancelled("levels of detail");
    } while (!order_to_come.is_there_within(std::chrono::milliseconds(20)));
    auto taken = order_to_come.take();
    if (!taken) return taken.error();
    order = std::move(*taken);
    return {};
  };
  const auto encode = [&](const Basis& basis, const BakeOptions& of, BakeResult& into) -> Result<void> {
    Asset exact = asset_from(surface, appearance, normals, basis, *order, of);
    exact.operator_kind = operator_of(surface, *laplacian, of);
    if (of.rank == options.rank) exact.level_errors = level_errors_of(exact, surface, poses);  // Not of the first.
    const AssetEncoding encoding = encoding_of(exact, basis, of);
    if (const DetailKind detail = detail_of(of); detail != DetailKind::kNone)
      exact.detail = detail_from(detail, exact, surface, normals, encoding);
    if (auto encoded = store(into.encoded, encode_asset(exact, encoding)); !encoded) return encoded;
    const auto decoded = store(into.asset, decode_asset(into.encoded));
    return decoded ? decoded : in_context("the asset just encoded cannot be decoded", decoded.error());
  };
  if (goes_first(surface.vertex_count(), options)) {
    BakeOptions first = options;
    first.rank = kFirstRank;
    auto basis = build_basis(surface, *laplacian, {options.basis, kFirstRank, options.solver, true},
                             stages.within(kLaplacianDone, kLaplacianDone));
    if (!basis) return basis.error();
    if (auto ordered = await_order(kLaplacianDone); !ordered) return ordered.error();
    BakeResult provisional;
    provisional.approximate = true;
    if (auto encoded = encode(*basis, first, provisional); !encoded) return encoded.error();
    options.first(provisional);
  }
  const Progress solving = stages.within(kLaplacianDone, kBasisDone);
  BasisTrial trial;
  if (samples != nullptr) {
    trial.vertices = samples->vertices;
    trial.choose = [&](std::span<const OfferedBasis> offers) -> Result<BasisShape> {
      if (!stages.at(kBasisDone, "trying ranks")) return cancelled("trying ranks");
      auto tried = try_ranks(offers, *laplacian, bounding_box(surface.positions).diagonal(),
                             centroid_of(surface, laplacian->mass, laplacian->area), *samples, *options.wish);
      if (!tried) return tried.error();
      result.trial = std::move(*tried);
      return BasisShape{result.trial->chosen.rank, result.trial->chosen.products};
    };
  }
  auto basis = basis_of(surface, *laplacian, options, samples != nullptr ? &trial : nullptr, solving);
  if (!basis) return basis.error();
  if (samples != nullptr) options.rank = static_cast<int>(basis->Psi.cols());
  if (auto ordered = await_order(kBasisDone); !ordered) return ordered.error();
  if (!stages.at(kOrderDone, "encoding")) return cancelled("encoding");
  if (auto encoded = encode(*basis, options, result); !encoded) return encoded.error();
  if (result.trial) {
    settle_coding(*result.trial, result.asset, *laplacian, *samples);
    result.asset.coding_error = result.trial->chosen.coding * result.asset.diagonal();
  }
  result.certified = basis->certified;
  result.approximate = basis->approximate;
  result.residual = basis->residual;
  const double seconds = static_cast<double>(steady_now_us() - start) / 1e6;
  result.report = report_of(result, {surface, poses.size(), options, *laplacian, *basis, seconds,
                                     bake_bytes(surface.vertex_count(), options)});
  if (result.trial) result.report += text_of(*result.trial) + '\n';
  result.report += appearance.report;
  return result;
}

}  // namespace

// Eigenvectors, candidates and basis side by side, and the vectors of one Lanczos band (beyond kExactMaxVertices none);
// or a motion's columns as given and as worked on. Measured: 6.7 to 9.9 KB a vertex at rank 200.
double bake_bytes(std::size_t vertices, const BakeOptions& options) {
  auto columns = vertices <= std::size_t{kExactMaxVertices} ? 4.5 * options.rank + 360 : 3.0 * options.rank + 180;
  if (options.motion != nullptr && options.motion->columns.count > 0)
    columns = 5 * static_cast<double>(options.motion->columns.count) + 60;
  if (detail_of(options) != DetailKind::kNone) columns += 2.0 * options.rank;  // as integers, and while coded
  const double of_poses = options.motion != nullptr && vertices <= kMaxPosedVertices ? 250.0 * kPosesOfLevels : 0;
  const double of_trial = options.wish ? kTrialBytes * static_cast<double>(std::min(vertices, kMaxJudges)) : 0;
  return kProgramBytes + of_trial +
         static_cast<double>(vertices) * (8 * columns + of_poses + (uses_kernel(options) ? kKernelBytes : 0));
}

DetailKind detail_of(const BakeOptions& options) {
  return options.detail.value_or(options.basis == BasisKind::kHarmonic ? DetailKind::kFrames : DetailKind::kNone);
}

Result<BakeResult> bake(const Surface& given, const BakeOptions& options, const std::string& cache_dir,
                        const BakeProgress& progress) {
  const Stages stages(progress);
  if (!stages.at(0, "checking")) return cancelled("checking");
  if (auto valid = validate_surface(given); !valid) return valid.error();
  BakeOptions to_do = options;
  if (options.wish) to_do.rank = trial_rank(given.vertex_count(), options);
  if (auto checked = check_options(given, to_do); !checked) return checked.error();
  const std::vector<bool> turned = faces_to_turn(given);
  std::optional<Surface> oriented;
  if (!turned.empty()) turn_faces(turned, oriented.emplace(given).faces);
  const Surface& surface = oriented ? *oriented : given;
  std::optional<SamplePoses> samples;
  if (options.wish) {
    auto sampled = sample_poses(surface, options.samples != nullptr ? options.samples : options.motion);
    if (!sampled) return sampled.error();
    samples = std::move(*sampled);
  }
  const SamplePoses* judges = samples ? &*samples : nullptr;
  const PlannedAppearance appearance = planned_appearance(given, turned, options.appearance);
  const AssetCache cache(cache_dir);
  const std::vector<std::vector<Vec3>> poses = poses_of_levels(surface, options.motion);
  const auto key = cache_dir.empty() ? Result<Sha256>(Sha256{}) : key_of(surface, poses, appearance, to_do, judges);
  if (!key) return key.error();
  try {
    if (!cache_dir.empty()) {
      if (auto found = load_bake(cache, *key, options.wish)) {
        stages.at(1, "found in the cache");
        return std::move(*found);
      }
    }
    const auto shape = cache_dir.empty() ? std::nullopt : shape_of(surface, appearance, to_do);
    if (auto moved = shape ? load_moved(cache, *shape, surface) : std::nullopt) {
      stages.at(1, "found in the cache, moved");
      return std::move(*moved);
    }
    auto result = bake_afresh(surface, poses, appearance, to_do, judges, stages);
    // More columns may do. (Fewer than asked for are all that the surface has.)
    if (result && result->trial && !result->trial->is_met() && !result->trial->is_rate &&
        result->trial->chosen.rank == kTrialRank && to_do.rank == kTrialRank) {
      to_do.rank = kLastRank;
      if (check_options(surface, to_do)) result = bake_afresh(surface, poses, appearance, to_do, judges, stages);
    }
    if (!result) return result;
    if (!cache_dir.empty()) {
      // Minutes of work are not thrown away because a disk is full.
      auto stored = store_bake(cache, *key, *result);
      if (stored && shape) stored = store_place(cache, *shape, *key, surface);
      if (!stored) result->not_kept = stored.error().message;
    }
    stages.at(1, "done");
    return result;
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory to bake " + std::to_string(surface.vertex_count()) +
                                          " vertices: lower the rank or simplify the surface");
  }
}

}  // namespace eigencast
