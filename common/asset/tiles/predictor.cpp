// SPDX-License-Identifier: MIT
#include "common/asset/tiles/predictor.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace eigencast {
namespace {

constexpr std::size_t kColumnsLookedAt = 64;
constexpr std::size_t kMaxCandidates = 64;
constexpr std::size_t kNearest = 10;      // candidates that are weighed
constexpr std::size_t kMaxChosen = 6;     // more cost more than they save
constexpr double kRidge = 1e-4;           // of the mean squared length: keeps weights small
constexpr double kBitsOfOne = 14;         // what one more predictor costs in the tile
constexpr std::size_t kMaxChildren = 16;  // of one row that are tried
constexpr std::uint32_t kNone = 0xffffffff;

static_assert(kMaxChosen <= Predictors::kMaxPerRow);

/// Some columns of the basis side by side, each in units of its residual against the parent.
class Sample {
 public:
  Sample(const Asset& asset, std::uint32_t exact_columns, std::span<const float> scales) {
    std::vector<std::uint32_t> columns;
    const std::size_t stride = std::max<std::size_t>(1, (scales.size() + kColumnsLookedAt - 1) / kColumnsLookedAt);
    for (std::size_t k = 0; k < scales.size(); k += stride) {
      if (scales[k] > 0) columns.push_back(static_cast<std::uint32_t>(k));
    }
    width_ = columns.size();
    values_.resize(std::size_t{asset.vertex_count} * width_);
    for (std::size_t c = 0; c < width_; ++c) {
      const auto entry = [&](std::uint32_t row) {
        return double{asset.entry(row, exact_columns + columns[c])} / scales[columns[c]];
      };
      double residual = 0;
      for (std::uint32_t i = 0; i < asset.vertex_count; ++i) residual += std::abs(entry(i) - entry(asset.map[i]));
      const double unit = residual / asset.vertex_count + 0.5;
      for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
        values_[i * width_ + c] = static_cast<float>(entry(i) / unit);
      }
    }
  }

  std::size_t width() const { return width_; }
  double dot(std::uint32_t a, std::uint32_t b) const {
    const float* x = &values_[a * width_];
    const float* y = &values_[b * width_];
    std::array<float, 4> sums{};
    std::size_t c = 0;
    for (; c + 4 <= width_; c += 4) {
      for (std::size_t lane = 0; lane < 4; ++lane) sums[lane] += x[c + lane] * y[c + lane];
    }
    double sum = double{sums[0]} + double{sums[1]} + double{sums[2]} + double{sums[3]};
    for (; c < width_; ++c) sum += double{x[c]} * y[c];
    return sum;
  }

 private:
  std::size_t width_ = 0;
  std::vector<float> values_;
};

/// Gram matrix of the nearest candidates, and their products with the row to predict.
struct Normal {
  std::size_t size = 0;
  std::array<std::uint32_t, kNearest> row{};
  std::array<std::array<double, kNearest>, kNearest> G{};
  std::array<double, kNearest> g{};
  double own = 0;
};

using Weights = std::array<double, kMaxChosen>;

/// The least-squares weights of the chosen candidates, by Cholesky's factorisation.
Weights solve(const Normal& normal, std::span<const std::size_t> chosen) {
  const std::size_t n = chosen.size();
  std::array<std::array<double, kMaxChosen>, kMaxChosen> R{};
  Weights w{};
  double trace = 1e-12;
  for (const std::size_t c : chosen) trace += normal.G[c][c];
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = normal.G[chosen[i]][chosen[j]] + (i == j ? kRidge * trace / static_cast<double>(n) : 0);
      for (std::size_t k = 0; k < j; ++k) sum -= R[i][k] * R[j][k];
      R[i][j] = i == j ? std::sqrt(std::max(sum, 1e-12 * trace)) : sum / R[j][j];
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    double sum = normal.g[chosen[i]];
    for (std::size_t k = 0; k < i; ++k) sum -= R[i][k] * w[k];
    w[i] = sum / R[i][i];
  }
  for (std::size_t i = n; i-- > 0;) {
    for (std::size_t k = i + 1; k < n; ++k) w[i] -= R[k][i] * w[k];
    w[i] /= R[i][i];
  }
  constexpr double kOne = 1 << Predictors::kOneBits;
  for (std::size_t i = 0; i < n; ++i) {
    const double whole =
        std::clamp(std::nearbyint(w[i] * kOne), -double{Predictors::kMaxWeight}, double{Predictors::kMaxWeight});
    w[i] = whole / kOne;
  }
  return w;
}

double squared_residual(const Normal& normal, std::span<const std::size_t> chosen, const Weights& w) {
  double sum = normal.own;
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    sum -= 2 * w[i] * normal.g[chosen[i]];
    for (std::size_t j = 0; j < chosen.size(); ++j) sum += w[i] * w[j] * normal.G[chosen[i]][chosen[j]];
  }
  return std::max(sum, 0.0);
}

class Chooser {
 public:
  Chooser(const Asset& asset, const Sample& sample, std::size_t columns)
      : asset_(asset),
        sample_(sample),
        columns_(static_cast<double>(columns)),
        newest_child_(asset.vertex_count, kNone),
        older_sibling_(asset.vertex_count, kNone),
        stamp_(asset.vertex_count, kNone) {}

  Predictors run() {
    for (std::uint32_t i = 0; i < asset_.vertex_count; ++i) {
      if (sample_.width() > 0) {
        gather(i);
        choose(i);
      }
      result_.end_row();
      if (i < asset_.base_count) continue;
      older_sibling_[i] = newest_child_[asset_.map[i]];
      newest_child_[asset_.map[i]] = i;
    }
    return std::move(result_);
  }

 private:
  void add(std::uint32_t row) {
    if (stamp_[row] == now_ || candidates_.size() == kMaxCandidates) return;
    stamp_[row] = now_;
    candidates_.push_back(row);
  }
  void add_predictors_of(std::uint32_t row) {
    for (std::uint32_t at = result_.first[row]; at < result_.first[row + 1]; ++at) add(result_.rows[at]);
  }
  void add_children_of(std::uint32_t row) {
    std::uint32_t child = newest_child_[row];
    for (std::size_t k = 0; k < kMaxChildren && child != kNone; ++k, child = older_sibling_[child]) add(child);
  }

  void gather(std::uint32_t i) {
    now_ = i;
    candidates_.clear();
    if (i < asset_.base_count) {
      for (std::uint32_t back = 1; back <= std::min<std::uint32_t>(i, kMaxCandidates); ++back) add(i - back);
      return;
    }
    const std::uint32_t parent = asset_.map[i];
    add(parent);
    add_predictors_of(parent);
    add_children_of(parent);
    for (std::size_t at = 1, nearby = candidates_.size(); at < nearby; ++at) {
      add_predictors_of(candidates_[at]);
      add_children_of(candidates_[at]);
    }
  }

  Normal nearest(std::uint32_t i) {
    Normal normal;
    normal.own = sample_.dot(i, i);
    distances_.clear();
    for (const std::uint32_t row : candidates_) {
      const double along = sample_.dot(i, row);
      distances_.push_back({sample_.dot(row, row) - 2 * along, along, row});
    }
    normal.size = std::min(kNearest, distances_.size());
    std::partial_sort(distances_.begin(), distances_.begin() + static_cast<std::ptrdiff_t>(normal.size),
                      distances_.end(), [](const Distance& a, const Distance& b) {
                        return a.squared != b.squared ? a.squared < b.squared : a.row < b.row;
                      });
    for (std::size_t a = 0; a < normal.size; ++a) {
      normal.row[a] = distances_[a].row;
      normal.g[a] = distances_[a].along;
      for (std::size_t b = 0; b <= a; ++b) {
        normal.G[a][b] = normal.G[b][a] = sample_.dot(normal.row[a], normal.row[b]);
      }
    }
    return normal;
  }

  double bits(double squared_error, std::size_t predictors) const {
    const double each = squared_error / static_cast<double>(sample_.width());
    return 0.5 * columns_ * std::log2(0.3 + each) + kBitsOfOne * static_cast<double>(predictors);
  }

  static std::size_t most_useful(const Normal& normal, std::span<const std::size_t> chosen, const Weights& w) {
    double most = -1;
    std::size_t result = 0;
    for (std::size_t c = 0; c < normal.size; ++c) {
      if (std::find(chosen.begin(), chosen.end(), c) != chosen.end()) continue;
      double residual = normal.g[c];
      for (std::size_t k = 0; k < chosen.size(); ++k) residual -= w[k] * normal.G[c][chosen[k]];
      const double gain = residual * residual / std::max(normal.G[c][c], 1e-12);
      if (gain > most) {
        most = gain;
        result = c;
      }
    }
    return result;
  }

  /// Takes the nearest candidate, then the one that reduces the residual most, while that pays.
  void choose(std::uint32_t i) {
    const Normal normal = nearest(i);
    std::array<std::size_t, kMaxChosen> chosen{};
    std::size_t count = 0, best_count = 0;
    Weights weights{}, best{};
    double least = bits(normal.own, 0);
    while (count < std::min(kMaxChosen, normal.size)) {
      chosen[count] = count == 0 ? 0 : most_useful(normal, std::span(chosen).first(count), weights);
      ++count;
      const std::span<const std::size_t> now(chosen.data(), count);
      weights = solve(normal, now);
      const double cost = bits(squared_residual(normal, now, weights), count);
      if (cost < least) {
        least = cost;
        best = weights;
        best_count = count;
      }
    }
    for (std::size_t k = 0; k < best_count; ++k) {
      result_.rows.push_back(normal.row[chosen[k]]);
      result_.weights.push_back(static_cast<std::int16_t>(std::lrint(best[k] * (1 << Predictors::kOneBits))));
    }
  }

  struct Distance {
    double squared, along;
    std::uint32_t row;
  };

  const Asset& asset_;
  const Sample& sample_;
  double columns_;
  Predictors result_;
  std::vector<std::uint32_t> newest_child_, older_sibling_, stamp_;
  std::uint32_t now_ = 0;
  std::vector<std::uint32_t> candidates_;
  std::vector<Distance> distances_;
};

}  // namespace

Predictors choose_predictors(const Asset& asset, std::uint32_t exact_columns, std::span<const float> column_scales) {
  const Sample sample(asset, exact_columns, column_scales);
  return Chooser(asset, sample, column_scales.size()).run();
}

Predictors part_of(const Predictors& all, std::uint32_t begin, std::uint32_t end) {
  Predictors part;
  for (std::uint32_t i = begin; i < end; ++i) {
    part.rows.insert(part.rows.end(), all.rows.begin() + all.first[i], all.rows.begin() + all.first[i + 1]);
    part.weights.insert(part.weights.end(), all.weights.begin() + all.first[i], all.weights.begin() + all.first[i + 1]);
    part.end_row();
  }
  return part;
}

}  // namespace eigencast
