// SPDX-License-Identifier: MIT
#include "sdk/rank_trial.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <tuple>
#include <utility>

#include "common/codec/chain.h"
#include "common/core/text.h"
#include "common/core/worker_team.h"
#include "common/spectral/augment.h"
#include "common/spectral/prefix_fit.h"
#include "common/surface/vector.h"
#include "common/wire/envelope.h"
#include "common/wire/link_bytes.h"
#include "sdk/bake_parts.h"

namespace eigencast {
namespace {

constexpr std::size_t kRun = 16, kRuns = 8, kMaxPoses = kRun * kRuns;
constexpr std::size_t kMaxRead = 8'000'000;  // vertices of all sample poses together
constexpr std::size_t kSettled = 3;          // keys from which on a run is predicted from two of its own

constexpr std::array kRanks{25, 50, 100, 150, 200, 250, 300, 400, 512};
constexpr int kReferenceRank = 200;
constexpr double kReferenceCoding = 1e-3;
constexpr double kFinest = 1.25e-4, kCoarsest = 8e-3;  // of the diagonal, in steps of 2
constexpr int kBisections = 6;                         // towards the wish, of each rank
constexpr double kColumnPrice = 5e-4;

std::vector<std::uint32_t> spread(std::size_t n) {
  std::vector<std::uint32_t> vertices(std::min(n, kMaxJudges));
  for (std::size_t i = 0; i < vertices.size(); ++i) vertices[i] = static_cast<std::uint32_t>(i * n / vertices.size());
  return vertices;
}

/// False: a position is not finite.
bool add_pose(SamplePoses& poses, std::span<const Vec3> pose) {
  const Eigen::MatrixXd X = matrix_from_positions(pose)(poses.vertices, Eigen::all);
  if (!X.allFinite()) return false;
  poses.positions.conservativeResize(X.rows(), poses.positions.cols() + 3);
  poses.positions.rightCols(3) = X;
  return true;
}

void end_run(SamplePoses& poses) {
  if (poses.count() > (poses.run_ends.empty() ? 0 : poses.run_ends.back())) poses.run_ends.push_back(poses.count());
}

/// Each turns the neighbourhoods of joints, as far from each other as can be, about the next joint.
SamplePoses made_poses(const Surface& rest) {
  constexpr std::size_t kJoints = 8, kPoses = 3 * kRun;
  constexpr double kSwing = 0.5;  // radians
  SamplePoses poses{spread(rest.vertex_count()), {}, {}, 30, true};
  const auto at = [&](std::size_t i) -> const Vec3& { return rest.positions[poses.vertices[i]]; };
  std::vector<Vec3> joints;
  std::vector<double> nearest(poses.vertices.size(), HUGE_VAL);
  double spacing = 1e-300;
  for (std::size_t joint = 0; joints.size() < kJoints;) {
    for (std::size_t i = 0; i < nearest.size(); ++i)
      nearest[i] = std::min(nearest[i], squared_distance(at(i), at(joint)));
    joint = static_cast<std::size_t>(std::max_element(nearest.begin(), nearest.end()) - nearest.begin());
    spacing = std::max(nearest[joint], spacing);
    joints.push_back(at(joint));
  }
  std::vector<Vec3> whole = rest.positions;
  for (std::size_t t = 0; t < kPoses; ++t) {
    for (const std::uint32_t vertex : poses.vertices) {
      const Vec3& x = rest.positions[vertex];
      double sum = 1e-300;
      Vec3 moved{};
      for (std::size_t j = 0; j < kJoints; ++j) {
        const double weight = std::exp(-4 * squared_distance(x, joints[j]) / spacing);
        const auto number = static_cast<double>(j);
        const double phase = 2.4 * (number + 1);  // the golden angle: none like another
        const double turns = (0.7 + 0.1 * number) * static_cast<double>(t) / poses.rate_hz;
        const double angle = kSwing * std::sin(phase + 2 * std::numbers::pi * turns);
        const Vec3 axis = unit({std::cos(phase), std::sin(phase), std::cos(2 * phase)});
        const Vec3 arm = x - joints[(j + 1) % kJoints];  // Turned by Rodrigues' formula.
        moved = moved +
                weight * (std::sin(angle) * cross(axis, arm) + (1 - std::cos(angle)) * (dot(axis, arm) * axis - arm));
        sum += weight;
      }
      whole[vertex] = x + (1 / sum) * moved;
    }
    add_pose(poses, whole);
  }
  end_run(poses);
  return poses;
}

struct Judges {
  const SamplePoses& poses;
  double area, diagonal;
};

/// C: r x 3 T. Nothing: a value leaves the codec's range.
std::optional<TrialPoint> tried(const Judges& judges, int products, const PrefixFit& fit, const Eigen::MatrixXd& C,
                                double coding) {
  const auto r = static_cast<std::uint32_t>(C.rows());
  const Quantiser quantiser = quantiser_for_error(coding * judges.diagonal, judges.area, r);
  const CoefficientLayout layout{CodecKind::kQuantised, r, 3, default_band_ends(r)};
  Eigen::MatrixXd received(C.rows(), C.cols());
  std::size_t bytes = 0, counted = 0, first = 0;
  for (const std::size_t end : judges.poses.run_ends) {
    std::optional<ChainState> state;
    for (std::size_t pose = first; pose < end; ++pose) {
      const auto at = static_cast<Eigen::Index>(3 * pose);
      Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> sent = C.middleCols(at, 3);
      auto key = key_from_coefficients(layout, {sent.data(), layout.size()}, quantiser.step);
      if (!key) return std::nullopt;
      if (state) {
        auto coded = encode_key(layout, *state, *key, quantiser.half_spacing);
        if (!coded) return std::nullopt;
        if (pose - first >= std::min(kSettled, end - first - 1))
          bytes += key_message_bytes(coded->payload.size()), ++counted;
        *key = std::move(coded->key);
      }
      const auto age = state ? static_cast<TimeUs>(1e6 / judges.poses.rate_hz) : 0;
      state = advanced(std::move(state), std::move(*key), age);
      const std::vector<double> now = coefficients_from_key(layout, state->newer);
      std::copy(now.begin(), now.end(), sent.data());
      received.middleCols(at, 3) = sent;
    }
    first = end;
  }
  const double each = static_cast<double>(bytes) / static_cast<double>(std::max<std::size_t>(counted, 1));
  return TrialPoint{static_cast<int>(r), products, coding, std::sqrt(fit.squared_error(received)) / judges.diagonal,
                    each * 8e-3 * judges.poses.rate_hz};
}

PrefixFit fit_of(const OfferedBasis& basis, const Laplacian& laplacian, const Vec3& origin, const SamplePoses& poses) {
  Eigen::MatrixXd X = poses.positions;
  for (Eigen::Index j = 0; j < X.cols(); ++j) X.col(j).array() -= origin[static_cast<std::size_t>(j % 3)];
  return {basis.rows, laplacian.mass(poses.vertices), X, static_cast<double>(laplacian.mass.size())};
}

/// Of one basis: from coarse to fine, then between the two that have what is asked for between them.
std::vector<TrialPoint> curve(const Judges& judges, int products, const PrefixFit& fit, int rank, double asked,
                              bool is_rate) {
  const Eigen::MatrixXd C = fit.coefficients(rank);
  const double finest = is_rate ? kFinest : std::clamp(asked / 8, kFinest / 1024, kFinest);
  std::vector<TrialPoint> points;
  double coarse = HUGE_VAL, fine = 0;
  const auto attempt = [&](double coding) {
    const auto point = tried(judges, products, fit, C, coding);
    if (!point) return;
    points.push_back(*point);
    const bool is_coarse = is_rate ? point->kbit_per_s <= asked : point->error > asked;
    (is_coarse ? coarse : fine) = is_coarse ? std::min(coarse, coding) : std::max(fine, coding);
  };
  for (double coding = kCoarsest; coding > 0.99 * finest; coding /= 2) attempt(coding);
  for (int i = 0; i < kBisections && fine > 0 && fine < coarse && coarse < HUGE_VAL; ++i)
    attempt(std::sqrt(fine * coarse));
  return points;
}

/// Offers and ranks to try; small ranks have the same columns in all offers.
std::vector<std::pair<std::size_t, int>> bases_of(std::span<const OfferedBasis> offers) {
  std::vector<std::pair<std::size_t, int>> bases;
  for (std::size_t offer = 0; offer < offers.size(); ++offer) {
    const auto most = static_cast<int>(offers[offer].rows.cols());
    for (const int rank : kRanks) {
      if (rank < most && (offer == 0 || rank > 10 * offers[0].products)) bases.emplace_back(offer, rank);
    }
    bases.emplace_back(offer, most);
  }
  return bases;
}

double asked_of(const BakeWish& wish, const TrialPoint& reference) {
  if (wish.kbit_per_s > 0) return wish.kbit_per_s;
  return wish.target_error > 0 ? wish.target_error : reference.error / wish.quality;
}

}  // namespace

double priced(double value, int rank) {
  return value * std::exp(kColumnPrice * rank);
}

RankTrial choose(std::vector<TrialPoint> points, const BakeWish& wish, bool is_made) {
  RankTrial trial{std::move(points), is_made, wish.kbit_per_s > 0};
  trial.asked = asked_of(wish, trial.points.front());
  const auto order = [&](const TrialPoint& p) {
    const double held = trial.held(p), cost = priced(trial.is_rate ? p.error : p.kbit_per_s, p.rank);
    return held > trial.asked ? std::tuple(true, held, cost) : std::tuple(false, cost, held);
  };
  trial.chosen = *std::min_element(trial.points.begin(), trial.points.end(),
                                   [&](const TrialPoint& a, const TrialPoint& b) { return order(a) < order(b); });
  return trial;
}

std::vector<TrialPoint> front_of(std::vector<TrialPoint> points) {
  const auto order = [](const TrialPoint& p) { return std::pair(priced(p.kbit_per_s, p.rank), p.error); };
  std::sort(points.begin(), points.end(),
            [&](const TrialPoint& a, const TrialPoint& b) { return order(a) < order(b); });
  double least = HUGE_VAL;
  std::erase_if(points, [&](const TrialPoint& p) { return !(p.error < least) || (least = p.error, false); });
  return points;
}

std::string text_of(const RankTrial& trial) {
  const TrialPoint& c = trial.chosen;
  const char* unit = trial.is_rate ? " kbit/s" : "";
  return formatted(
             "r = %d, %d groups of products, coded to within %.1e: error %.2e of the diagonal at %.1f kbit/s; "
             "asked for %.3g%s",
             c.rank, c.products, c.coding, c.error, c.kbit_per_s, trial.asked, unit) +
         (trial.is_met() ? ""
                         : formatted(", MISSED by a factor of %.2f: nothing that was tried comes closer",
                                     trial.held(c) / trial.asked)) +
         formatted(" (%zu ways tried on %s)", trial.points.size(),
                   trial.is_made ? "deformations of the rest pose, since there are no sample poses" : "sample poses");
}

std::size_t key_message_bytes(std::size_t payload) {
  const std::size_t message = payload + Envelope::kKeyBytes;
  return message + static_cast<std::size_t>(link_bytes(1, static_cast<double>(message)).websocket);
}

Result<SamplePoses> sample_poses(const Surface& rest, const KnownMotion* motion) {
  const std::size_t n = rest.vertex_count();
  if (motion == nullptr || motion->poses < 2) return made_poses(rest);
  SamplePoses poses{spread(n), {}, {}};
  if (motion->rate_hz >= 0.1 && motion->rate_hz <= 1000) poses.rate_hz = motion->rate_hz;
  const std::size_t most = std::clamp<std::size_t>(kMaxRead / std::max<std::size_t>(n, 1), kRun, kMaxPoses);
  const std::size_t runs = motion->poses <= most ? 1 : most / kRun, length = std::min(motion->poses, most / runs);
  for (std::size_t run = 0; run < runs; ++run) {
    const std::size_t first = run * (motion->poses - length) / std::max<std::size_t>(runs - 1, 1);
    for (std::size_t i = first; i < first + length; ++i) {
      const auto pose = motion->pose(i);
      if (pose && pose->size() != n) {
        return fail(ErrorCode::kInvalidArgument,
                    formatted("sample pose %zu has %zu vertices, the surface has %zu", i, pose->size(), n));
      }
      if (!pose || !add_pose(poses, *pose)) end_run(poses);
    }
    end_run(poses);
  }
  // Runs of one pose say nothing of the bits.
  return poses.count() > 2 * poses.run_ends.size() || motion->poses == poses.count() ? poses : made_poses(rest);
}

Result<RankTrial> try_ranks(std::span<const OfferedBasis> offers, const Laplacian& laplacian, double diagonal,
                            const Vec3& origin, const SamplePoses& poses, const BakeWish& wish) {
  const Judges judges{poses, laplacian.area, diagonal};
  std::vector<PrefixFit> fits;
  for (const OfferedBasis& offer : offers) fits.push_back(fit_of(offer, laplacian, origin, poses));
  const int known = std::min(kReferenceRank, static_cast<int>(offers.front().rows.cols()));
  const auto reference =
      tried(judges, offers.front().products, fits.front(), fits.front().coefficients(known), kReferenceCoding);
  if (!reference)
    return fail(ErrorCode::kNumerical, "no rank can be tried: the sample poses leave the codec's range; name a rank");
  const bool is_rate = wish.kbit_per_s > 0;
  const double asked = asked_of(wish, *reference);
  const auto bases = bases_of(offers);
  std::vector<std::vector<TrialPoint>> curves(bases.size());
  worker_team().run(bases.size(), [&](std::size_t i) {
    const auto [offer, rank] = bases[i];
    curves[i] = curve(judges, offers[offer].products, fits[offer], rank, asked, is_rate);
  });
  std::vector<TrialPoint> points{*reference};
  for (const auto& of_basis : curves) points.insert(points.end(), of_basis.begin(), of_basis.end());
  return choose(std::move(points), wish, poses.is_made);
}

void settle_coding(RankTrial& trial, const Asset& asset, const Laplacian& laplacian, const SamplePoses& poses) {
  std::vector<std::uint32_t> rows(asset.vertex_count);
  for (std::uint32_t row = 0; row < asset.vertex_count; ++row) rows[asset.source_vertex[row]] = row;
  OfferedBasis rounded{trial.chosen.products, Eigen::MatrixXd(poses.positions.rows(), trial.chosen.rank)};
  for (Eigen::Index i = 0; i < rounded.rows.size(); ++i) {
    const Eigen::Index N = rounded.rows.rows();
    const std::uint32_t vertex = poses.vertices[static_cast<std::size_t>(i % N)];
    rounded.rows(i % N, i / N) = asset.entry(rows[vertex], static_cast<std::size_t>(i / N));
  }
  auto points = curve({poses, laplacian.area, asset.diagonal()}, rounded.products,
                      fit_of(rounded, laplacian, asset.origin, poses), trial.chosen.rank, trial.asked, trial.is_rate);
  const BakeWish same{1, trial.is_rate ? 0 : trial.asked, trial.is_rate ? trial.asked : 0};
  if (!points.empty()) trial.chosen = choose(std::move(points), same).chosen;
  trial.points.push_back(trial.chosen);
}

}  // namespace eigencast
