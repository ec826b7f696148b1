// SPDX-License-Identifier: MIT
#include "sdk/learner.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numeric>
#include <utility>

#include "common/asset/format/reader.h"
#include "common/codec/chain.h"
#include "sdk/rank_trial.h"

namespace eigencast {
namespace {

constexpr double kRounding = 0.25;  ///< What rounding columns may move vertices by, of what coding may.
constexpr double kMaxStep = 2;      ///< Of a column's rms entry: beyond, hardly an entry is left.
constexpr double kLargestEntry = 32767;
constexpr Eigen::Index kMost = Learner::kMaxColumns;
constexpr std::size_t kMinPoses = 8;
constexpr double kFarCoarser = 8;  ///< Coding than eps.
constexpr int kHalvings = 8;
constexpr TimeUs kInterval = 33'333;

std::vector<double> weights_of(const Asset& asset) {
  std::vector<double> weights;
  for (const float mass : asset.mass) weights.push_back(std::sqrt(static_cast<double>(mass)));
  return weights;
}

std::size_t most_poses(std::uint32_t vertices) {
  const std::size_t most = Learner::kMaxBytes / (std::size_t{24} * std::max(vertices, 1U));
  return std::clamp<std::size_t>(most / 2 * 2, 2, Learner::kMaxPoses);
}

/// Poses coded one after the other.
struct CodedPoses {
  double error = 0, kbit_per_s = 0;
};

std::optional<CodedPoses> code_poses(const CoefficientLayout& layout, double area, double eps, double rate_hz,
                                     std::span<const std::vector<double>> poses) {
  const Quantiser quantiser = quantiser_for_error(eps, area, layout.rows);
  std::optional<ChainState> state;
  double squares = 0;
  std::size_t bytes = 0;
  for (const std::vector<double>& C : poses) {
    auto key = key_from_coefficients(layout, C, quantiser.step);
    if (!key) return std::nullopt;
    if (state) {
      auto coded = encode_key(layout, *state, *key, quantiser.half_spacing);
      if (!coded) return std::nullopt;
      bytes += key_message_bytes(coded->payload.size());
      squares += std::pow(surface_distance(C, coefficients_from_key(layout, coded->key), area), 2);
      key = std::move(coded->key);
    }
    state = advanced(std::move(state), std::move(*key), kInterval);
  }
  const auto frames = static_cast<double>(poses.size() - 1);
  return CodedPoses{std::sqrt(squares / frames), static_cast<double>(bytes) / frames * 8e-3 * rate_hz};
}

}  // namespace

std::optional<double> LearningTrial::payback_s(std::uint64_t bytes) const {
  const double saved = kbit_per_s - equal_kbit_per_s;
  if (saved <= 0) return std::nullopt;
  return static_cast<double>(bytes) * 8e-3 / saved;
}

bool LearningTrial::pays(std::uint64_t bytes) const {
  return basis_error > coding_error && payback_s(bytes).value_or(kStayS + 1) <= kStayS;
}

Learner::Learner(std::shared_ptr<const Asset> asset)
    : asset_(std::move(asset)),
      weights_(weights_of(*asset_)),
      snapshots_(weights_, most_poses(asset_->vertex_count)),
      rebuilt_(std::size_t{3} * asset_->vertex_count),
      residual_(rebuilt_.size()) {
  assert(asset_->complete());
  reconstructor_.update(*asset_);
}

void Learner::add(std::span<const float> positions, std::span<const double> C) {
  assert(positions.size() == residual_.size() && C.size() == std::size_t{3} * asset_->rank);
  if (snapshots_.is_due()) {
    reconstructor_.rebuild(C, 3, asset_->rank, asset_->vertex_count, rebuilt_);
    for (std::size_t row = 0; row < weights_.size(); ++row) {
      const std::size_t source = asset_->source_vertex[row];
      for (std::size_t d = 0; d < 3; ++d)
        residual_[3 * row + d] = double{positions[3 * source + d]} - asset_->origin[d] - double{rebuilt_[3 * row + d]};
    }
    if (snapshots_.is_full()) {  // As the snapshots do.
      for (std::size_t s = 0; 2 * s < coefficients_.size(); ++s) coefficients_[s] = std::move(coefficients_[2 * s]);
      coefficients_.resize(coefficients_.size() / 2);
    }
    coefficients_.emplace_back(C.begin(), C.end());
  }
  snapshots_.add(residual_);
}

LearntColumns Learner::columns(double eps) const {
  Components found = components_of(snapshots_.gram(), kMost);
  const Eigen::MatrixXd h = snapshots_.combined(found.T);
  const auto n = static_cast<Eigen::Index>(weights_.size());
  const Eigen::Map<const Eigen::VectorXd> weights(weights_.data(), n);
  const Eigen::MatrixXd columns = weights.cwiseSqrt().cwiseInverse().asDiagonal() * h;
  const Eigen::VectorXd norms =
      (weights.cwiseAbs2().asDiagonal() * columns.cwiseAbs2()).colwise().sum().cwiseSqrt();  // W^2 = M
  LearntColumns learnt;
  const double coding = eps * std::sqrt(asset_->area / asset_->rank);
  for (Eigen::Index k = 0; k < norms.size(); ++k) {
    const double amplitude = norms[k] * std::sqrt(found.squares[k] / static_cast<double>(poses()));
    if (amplitude < coding) break;
    learnt.amplitudes.push_back(amplitude);
  }
  const std::size_t count = learnt.amplitudes.size();
  for (std::size_t k = 0; k < count; ++k) {  // As AssetEncoding: all columns add equally.
    const auto column = static_cast<Eigen::Index>(k);
    const double wanted = kRounding * eps * std::sqrt(12.0 / static_cast<double>(count)) / learnt.amplitudes[k];
    const double finest = columns.col(column).cwiseAbs().maxCoeff() / norms[column] / kLargestEntry;
    const double step = std::max(std::min(wanted, kMaxStep / std::sqrt(asset_->area)), finest);
    learnt.columns.scales.push_back(static_cast<float>(step));
  }
  learnt.columns.values.resize(weights_.size() * count);
  for (std::size_t i = 0; i < learnt.columns.values.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i % count);
    learnt.columns.values[i] = static_cast<float>(columns(static_cast<Eigen::Index>(i / count), k) / norms[k]);
  }
  return learnt;
}

Result<Asset> learnt_asset(const Asset& asset, const EncodedColumns& columns) {
  const auto reader = AssetReader::from_manifest(columns.manifest.id, columns.manifest.bytes);
  if (!reader) return reader.error();
  return with_columns(asset, columns.section.bytes, reader->chunk_ends());
}

std::optional<LearningTrial> Learner::trial(double eps, double rate_hz) const {
  const std::size_t half = poses() / 2, judged = poses() - half;
  if (poses() < kMinPoses) return std::nullopt;
  const Eigen::MatrixXd gram = snapshots_.gram();
  const auto first = static_cast<Eigen::Index>(3 * half), rest = static_cast<Eigen::Index>(3 * judged);
  const Components found = components_of(gram.topLeftCorner(first, first), kMost);
  const Eigen::MatrixXd A = found.T.transpose() * gram.topRightCorner(first, rest);  // k x 3 judged
  const double weight = std::accumulate(weights_.begin(), weights_.end(), 0.0);
  const auto rms = [&](double squares) {
    return std::sqrt(std::max(squares, 0.0) / weight / static_cast<double>(judged));
  };
  const double missed = gram.bottomRightCorner(rest, rest).trace();
  LearningTrial trial;
  trial.basis_error = rms(missed);
  trial.learnt_error = rms(missed - A.squaredNorm());

  CoefficientLayout layout{CodecKind::kQuantised, asset_->rank, 3, asset_->band_ends};
  std::vector<std::vector<double>> poses_judged(coefficients_.begin() + static_cast<std::ptrdiff_t>(half),
                                                coefficients_.end());
  rate_hz /= static_cast<double>(snapshots_.stride());
  const auto plain = code_poses(layout, asset_->area, eps, rate_hz, poses_judged);
  if (!plain) return std::nullopt;
  trial.coding_error = plain->error;
  trial.kbit_per_s = trial.equal_kbit_per_s = plain->kbit_per_s;
  if (A.rows() == 0) return trial;

  layout.band_ends.push_back(layout.rows += static_cast<std::uint32_t>(A.rows()));
  for (std::size_t s = 0; s < judged; ++s) {
    // Residuals are weighed by the roots of masses; coefficients are to give areas, as the masses do on average.
    const Eigen::MatrixXd more =
        std::sqrt(asset_->area / weight) * A.middleCols(static_cast<Eigen::Index>(3 * s), 3).transpose();
    poses_judged[s].insert(poses_judged[s].end(), more.data(), more.data() + more.size());
  }
  const double allowed = trial.equal_error = std::hypot(trial.basis_error, trial.coding_error);
  struct Tried {
    double eps, error, kbit_per_s;
  };
  const auto bisect = [&](double fine, const auto& may_be_finer) {
    double coarse = kFarCoarser * eps;
    for (int i = 0; i < kHalvings; ++i) {
      const double middle = std::sqrt(fine * coarse);
      const auto tried = code_poses(layout, asset_->area, middle, rate_hz, poses_judged);
      if (!tried) return false;
      const double error = std::hypot(trial.learnt_error, tried->error);
      (may_be_finer(Tried{middle, error, tried->kbit_per_s}) ? coarse : fine) = middle;
    }
    return true;
  };
  const bool is_done = bisect(eps / 2,
                              [&](const Tried& tried) {
                                trial.equal_kbit_per_s = tried.kbit_per_s;
                                return tried.error > allowed;
                              }) &&
                       bisect(eps, [&](const Tried& tried) {
                         const bool is_enough = tried.kbit_per_s <= trial.kbit_per_s;
                         if (is_enough) trial.coarser = tried.eps / eps, trial.equal_error = tried.error;
                         return is_enough;
                       });
  if (!is_done) return std::nullopt;
  return trial;
}

}  // namespace eigencast
