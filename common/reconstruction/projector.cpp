// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <string>

#include "common/reconstruction/kernel.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

// Rows summed in float before they are added in double: few enough that rounding stays below that of the basis itself.
constexpr std::size_t kForwardBlock = 32;
constexpr std::size_t kGramBlock = 64;

// Psi^T M Psi, r x r; only the lower triangle is meant.
std::vector<double> gram_matrix(const Asset& asset) {
  const std::size_t n = asset.vertex_count, r = asset.rank;
  const std::size_t width = (r + kernel::kGramTile - 1) / kernel::kGramTile * kernel::kGramTile;
  std::vector<double> padded(width * width), block(kGramBlock * width);
  for (std::size_t first = 0; first < n; first += kGramBlock) {
    const std::size_t rows = std::min(kGramBlock, n - first);
    for (std::size_t i = 0; i < rows; ++i) {
      const double root = std::sqrt(static_cast<double>(asset.mass[first + i]));
      const float* row = &asset.basis[(first + i) * r];
      for (std::size_t k = 0; k < r; ++k) block[i * width + k] = root * static_cast<double>(row[k]);
    }
    kernel::add_gram(block.data(), rows, width, padded.data());
  }
  std::vector<double> gram(r * r);
  for (std::size_t i = 0; i < r; ++i) std::copy_n(&padded[i * width], i + 1, &gram[i * r]);
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

// Solves L L^T C = C in place; C is r x 3, row-major.
void solve(const std::vector<double>& L, std::size_t r, std::vector<double>& C) {
  for (std::size_t d = 0; d < 3; ++d) {
    for (std::size_t i = 0; i < r; ++i) {
      double value = C[3 * i + d];
      for (std::size_t k = 0; k < i; ++k) value -= L[i * r + k] * C[3 * k + d];
      C[3 * i + d] = value / L[i * r + i];
    }
  }
  for (std::size_t i = r; i-- > 0;) {
    for (std::size_t d = 0; d < 3; ++d) C[3 * i + d] /= L[i * r + i];
    for (std::size_t k = 0; k < i; ++k) {
      for (std::size_t d = 0; d < 3; ++d) C[3 * k + d] -= L[i * r + k] * C[3 * i + d];
    }
  }
}

template <typename Value>
Result<std::vector<double>> project(const Asset& asset, const std::vector<double>& factor,
                                    std::span<const Value> positions) {
  const std::size_t n = asset.vertex_count, r = asset.rank;
  if (positions.size() != 3 * n) {
    return fail(ErrorCode::kInvalidArgument, "positions: " + std::to_string(positions.size()) +
                                                 " values, the asset has " + std::to_string(n) +
                                                 " vertices and needs 3 for each");
  }
  std::vector<double> sums(3 * r);
  std::vector<float> block_sums(3 * r);
  std::array<float, 3 * kForwardBlock> weighted;
  for (std::size_t first = 0; first < n; first += kForwardBlock) {
    const std::size_t rows = std::min(kForwardBlock, n - first);
    for (std::size_t i = 0; i < rows; ++i) {
      const std::size_t source = asset.source_vertex[first + i];
      for (std::size_t d = 0; d < 3; ++d) {
        const auto value = static_cast<double>(positions[3 * source + d]);
        if (!std::isfinite(value)) {
          return fail(ErrorCode::kInvalidArgument,
                      "positions: vertex " + std::to_string(source) + " has a coordinate that is not a finite number");
        }
        weighted[3 * i + d] = static_cast<float>(asset.mass[first + i] * (value - asset.origin[d]));
      }
    }
    std::fill(block_sums.begin(), block_sums.end(), 0.0F);
    kernel::add_transposed_product(&asset.basis[first * r], rows, r, weighted.data(), block_sums.data());
    for (std::size_t k = 0; k < 3 * r; ++k) sums[k] += static_cast<double>(block_sums[k]);
  }
  std::vector<double> C(3 * r);
  for (std::size_t k = 0; k < r; ++k) {
    for (std::size_t d = 0; d < 3; ++d) C[3 * k + d] = sums[d * r + k];
  }
  solve(factor, r, C);
  return C;
}

}  // namespace

Result<Projector> Projector::create(const Asset& asset) {
  assert(asset.complete());
  Projector projector;
  projector.asset_ = &asset;
  projector.gram_factor_ = gram_matrix(asset);
  const std::size_t bad = factorise(projector.gram_factor_, asset.rank);
  if (bad < asset.rank) {
    return fail(ErrorCode::kNumerical,
                "basis: column " + std::to_string(bad) +
                    " depends on the columns before it, so positions have no unique coefficients; "
                    "bake the asset again with fewer columns");
  }
  return projector;
}

Result<std::vector<double>> Projector::coefficients_from_positions(std::span<const float> positions) const {
  return project(*asset_, gram_factor_, positions);
}

Result<std::vector<double>> Projector::coefficients_from_positions(std::span<const double> positions) const {
  return project(*asset_, gram_factor_, positions);
}

}  // namespace eigencast
