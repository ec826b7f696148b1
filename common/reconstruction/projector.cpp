// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <atomic>
#include <cassert>
#include <cmath>
#include <string>

#include "common/core/worker_team.h"
#include "common/reconstruction/kernel.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

// Tiles summed in float before their sum is added in double: few enough that rounding stays below that of the basis.
constexpr std::size_t kForwardTiles = 32;
constexpr std::size_t kGramBlock = 64;
constexpr std::size_t kGramParts = 8;  // whatever the number of threads: the sums are the same everywhere
constexpr std::size_t kWorthThreadsToProject = 10'000'000;  // multiplications
constexpr std::size_t kFitsCache = 512 * 1024;              // bytes of positions that stay until they are used

std::size_t whole_gram_tiles(std::size_t columns) {
  return (columns + kernel::kGramTile - 1) / kernel::kGramTile * kernel::kGramTile;
}

// Psi^T W Psi, r x r, lower triangle.
std::vector<double> gram_matrix(const Asset& asset, const std::vector<double>& weights,
                                const kernel::Functions& functions) {
  const std::size_t n = asset.vertex_count, r = asset.rank;
  const std::size_t width = whole_gram_tiles(r);
  std::vector<std::vector<double>> parts(kGramParts);
  worker_team().run(kGramParts, [&](std::size_t part) {
    parts[part].resize(width * width);
    std::vector<double> block(kGramBlock * width);
    std::vector<float> row(r);
    const std::size_t end = n * (part + 1) / kGramParts;
    for (std::size_t first = n * part / kGramParts; first < end; first += kGramBlock) {
      const std::size_t rows = std::min(kGramBlock, end - first);
      for (std::size_t i = 0; i < rows; ++i) {
        const double root = std::sqrt(weights[first + i]);
        asset.copy_row(first + i, row);
        for (std::size_t k = 0; k < r; ++k) block[i * width + k] = root * static_cast<double>(row[k]);
      }
      functions.add_gram(block.data(), rows, width, parts[part].data());
    }
  });
  std::vector<double> gram(r * r);
  for (const std::vector<double>& part : parts) {
    for (std::size_t i = 0; i < r; ++i) {
      for (std::size_t j = 0; j <= i; ++j) gram[i * r + j] += part[i * width + j];
    }
  }
  return gram;
}

// Replaces the lower triangle of A (r x r, symmetric) by its Cholesky factor. Returns the column where A is not
// positive, or r.
std::size_t factorise(std::vector<double>& A, std::size_t r) {
  for (std::size_t j = 0; j < r; ++j) {
    const double* row_j = &A[j * r];
    for (std::size_t i = j; i < r; ++i) {
      const double* row_i = &A[i * r];
      double value = row_i[j];
      for (std::size_t k = 0; k < j; ++k) value -= row_i[k] * row_j[k];
      if (i > j) {
        A[i * r + j] = value / row_j[j];
      } else if (value > 1e-12 * row_j[j]) {
        A[j * r + j] = std::sqrt(value);
      } else {
        return j;
      }
    }
  }
  return r;
}

// The inverse of the lower triangle of L, r x r, in rows of `width`.
std::vector<double> inverse_of_triangle(const std::vector<double>& L, std::size_t r, std::size_t width) {
  std::vector<double> T(r * width);
  for (std::size_t i = 0; i < r; ++i) {
    double* row = &T[i * width];
    row[i] = 1;
    for (std::size_t k = 0; k < i; ++k) {
      for (std::size_t j = 0; j <= k; ++j) row[j] -= L[i * r + k] * T[k * width + j];
    }
    for (std::size_t j = 0; j <= i; ++j) row[j] /= L[i * r + i];
  }
  return T;
}

// W (X - origin) of the rows from `first` on, in the kernel's tiles. Returns whether all are finite.
template <typename Value>
bool weigh(const Asset& asset, const std::array<double, 3>& origin, std::span<const double> weights,
           std::span<const Value> positions, std::size_t first, std::size_t rows, float* Y) {
  std::array<double, 3> zero{};  // one per axis, so that no sum waits for another
  for (std::size_t i = 0; i < rows; ++i) {
    const Value* x = &positions[3 * std::size_t{asset.source_vertex[first + i]}];
    float* y = Y + i / kernel::kTileRows * 3 * kernel::kTileRows + i % kernel::kTileRows;
    for (std::size_t d = 0; d < 3; ++d) {
      const double weighted = weights[first + i] * (static_cast<double>(x[d]) - origin[d]);
      zero[d] += 0 * weighted;
      y[d * kernel::kTileRows] = static_cast<float>(weighted);
    }
  }
  return zero == std::array<double, 3>{};
}

// Prefetches as one stream what is then read in the asset's random order.
template <typename Value>
void prefetch(std::span<const Value> values) {
  constexpr std::size_t kLine = kernel::kAlignment / sizeof(Value);
  for (std::size_t i = 0; i < values.size(); i += kLine) __builtin_prefetch(values.data() + i);
}

template <typename Value>
Result<void> check_finite(std::span<const Value> positions) {
  const auto bad = std::find_if(positions.begin(), positions.end(), [](Value x) { return !std::isfinite(x); });
  if (bad == positions.end()) return {};
  return fail(ErrorCode::kInvalidArgument, "positions: vertex " + std::to_string((bad - positions.begin()) / 3) +
                                               " has a coordinate that is not a finite number");
}

}  // namespace

template <typename Value>
Result<std::vector<double>> Projector::project(std::span<const Value> positions,
                                               const std::array<double, 3>& origin) const {
  const std::size_t n = asset_->vertex_count, r = asset_->rank;
  if (positions.size() != 3 * n) {
    return fail(ErrorCode::kInvalidArgument, "positions: " + std::to_string(positions.size()) +
                                                 " values, the asset has " + std::to_string(n) +
                                                 " vertices and needs 3 for each");
  }
  constexpr std::size_t kRows = kForwardTiles * kernel::kTileRows;
  const std::size_t parts = (n + kRows - 1) / kRows;
  const std::size_t width = inverse_.size() / r;
  std::vector<std::vector<double>> sums(parts);
  std::atomic<bool> finite = true;
  const kernel::Functions& functions = kernel::functions(set_);
  if (positions.size_bytes() <= kFitsCache) prefetch(positions);
  const auto sum_part = [&](std::size_t part) {
    const std::size_t first = part * kRows, rows = std::min(kRows, n - first);
    const std::size_t tiles = (rows + kernel::kTileRows - 1) / kernel::kTileRows;
    AlignedVector<float> Y(tiles * 3 * kernel::kTileRows);  // zero beyond the last row
    AlignedVector<float> scratch(3 * (r + 1) * kernel::kWidestVector);
    sums[part].resize(3 * (r + 1));  // an odd last column of integers has a partner
    if (!weigh(*asset_, origin, weights_, positions, first, rows, Y.data())) finite = false;
    functions.add_transposed(tiles_.view(part * kForwardTiles, asset_->rank), tiles, Y.data(), sums[part].data(),
                             scratch.data());
  };
  if (threads_ == 1 || n * r * 3 < kWorthThreadsToProject) {
    for (std::size_t part = 0; part < parts; ++part) sum_part(part);
  } else {
    worker_team().run(parts, sum_part);
  }
  if (!finite) return check_finite(positions).error();

  std::vector<double> S(3 * width), by_axis(3 * width), C(3 * r);
  for (const std::vector<double>& part : sums) {
    for (std::size_t i = 0; i < 3 * r; ++i) S[i % 3 * width + i / 3] += part[i];
  }
  for (std::uint32_t k = 0; k < asset_->rank; ++k) {
    for (std::size_t d = 0; d < 3; ++d) S[d * width + k] *= tiles_.scale(k);
  }
  functions.add_inverse(inverse_.data(), r, width, S.data(), by_axis.data());
  for (std::size_t i = 0; i < 3 * r; ++i) C[i] = by_axis[i % 3 * width + i / 3];
  return C;
}

Result<Projector> Projector::create(const Asset& asset, InstructionSet set, unsigned threads) {
  assert(asset.complete());
  Projector projector;
  projector.asset_ = &asset;
  projector.set_ = set;
  projector.threads_ = threads;
  projector.tiles_.update(asset);
  for (const float mass : std::span(asset.mass).first(asset.vertex_count)) {
    projector.weights_.push_back(std::sqrt(static_cast<double>(mass)));
  }
  std::vector<double> gram = gram_matrix(asset, projector.weights_, kernel::functions(set));
  const std::size_t bad = factorise(gram, asset.rank);
  if (bad < asset.rank) {
    return fail(ErrorCode::kNumerical,
                "basis: column " + std::to_string(bad) +
                    " depends on the columns before it, so positions have no unique coefficients; "
                    "bake the asset again with fewer columns");
  }
  projector.inverse_ = inverse_of_triangle(gram, asset.rank, whole_gram_tiles(asset.rank));
  return projector;
}

Result<std::vector<double>> Projector::coefficients_from_positions(std::span<const float> positions) const {
  return project(positions, asset_->origin);
}

Result<std::vector<double>> Projector::coefficients_from_positions(std::span<const double> positions) const {
  return project(positions, asset_->origin);
}

Result<std::vector<double>> Projector::coefficients_from_vectors(std::span<const float> vectors) const {
  return project(vectors, {});
}

Result<std::vector<double>> Projector::coefficients_from_vectors(std::span<const double> vectors) const {
  return project(vectors, {});
}

}  // namespace eigencast
