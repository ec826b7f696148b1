// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cassert>
#include <cmath>
#include <string>

#include "common/core/worker_team.h"
#include "common/reconstruction/kernel.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

// Tiles whose products are summed in float, lane by lane, before they are added in double: few enough that rounding
// stays below that of the basis itself.
constexpr std::size_t kForwardTiles = 32;
constexpr std::size_t kGramBlock = 64;
// Independent of how many threads there are, so that the sums are the same everywhere.
constexpr std::size_t kGramParts = 8;
constexpr std::size_t kNone = ~std::size_t{0};

// The weight of each row in the fit: between area (mass), for which the error of the surface is least, and 1, for which
// that of the vertices is (docs/adr/0004).
std::vector<double> weights_of(const Asset& asset) {
  std::vector<double> weights(asset.vertex_count);
  for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = std::sqrt(static_cast<double>(asset.mass[i]));
  return weights;
}

// Psi^T W Psi, r x r; only the lower triangle is meant.
std::vector<double> gram_matrix(const Asset& asset, const std::vector<double>& weights,
                                const kernel::Functions& functions) {
  const std::size_t n = asset.vertex_count, r = asset.rank;
  const std::size_t width = (r + kernel::kGramTile - 1) / kernel::kGramTile * kernel::kGramTile;
  std::vector<std::vector<double>> parts(kGramParts);
  worker_team().run(kGramParts, [&](std::size_t part) {
    parts[part].resize(width * width);
    std::vector<double> block(kGramBlock * width);
    const std::size_t end = n * (part + 1) / kGramParts;
    for (std::size_t first = n * part / kGramParts; first < end; first += kGramBlock) {
      const std::size_t rows = std::min(kGramBlock, end - first);
      for (std::size_t i = 0; i < rows; ++i) {
        const double root = std::sqrt(weights[first + i]);
        const float* row = &asset.basis[(first + i) * r];
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

// Solves L L^T C = C in place; C is r x 3, row-major.
void solve(const std::vector<double>& L, std::size_t r, std::vector<double>& C) {
  for (std::size_t i = 0; i < r; ++i) {
    double value[3] = {C[3 * i], C[3 * i + 1], C[3 * i + 2]};
    for (std::size_t k = 0; k < i; ++k) {
      for (std::size_t d = 0; d < 3; ++d) value[d] -= L[i * r + k] * C[3 * k + d];
    }
    for (std::size_t d = 0; d < 3; ++d) C[3 * i + d] = value[d] / L[i * r + i];
  }
  for (std::size_t i = r; i-- > 0;) {
    for (std::size_t d = 0; d < 3; ++d) C[3 * i + d] /= L[i * r + i];
    for (std::size_t k = 0; k < i; ++k) {
      for (std::size_t d = 0; d < 3; ++d) C[3 * k + d] -= L[i * r + k] * C[3 * i + d];
    }
  }
}

// W (X - origin) of the rows from `first` on, tile by tile as the kernel wants it; zero beyond the last row. Returns the
// first source vertex that is not finite, or kNone.
template <typename Value>
std::size_t weigh(const Asset& asset, std::span<const double> weights, std::span<const Value> positions,
                  std::size_t first, std::size_t rows, std::vector<float>& Y) {
  std::size_t bad = kNone;
  for (std::size_t i = 0; i < rows; ++i) {
    const std::size_t source = asset.source_vertex[first + i];
    const Value* x = &positions[3 * source];
    float* y = &Y[i / kernel::kTileRows * 3 * kernel::kTileRows + i % kernel::kTileRows];
    for (std::size_t d = 0; d < 3; ++d) {
      if (!std::isfinite(x[d])) bad = std::min(bad, source);
      const double weighted = weights[first + i] * (static_cast<double>(x[d]) - asset.origin[d]);
      y[d * kernel::kTileRows] = static_cast<float>(weighted);
    }
  }
  for (std::size_t i = rows; i % kernel::kTileRows != 0; ++i) {
    float* y = &Y[i / kernel::kTileRows * 3 * kernel::kTileRows + i % kernel::kTileRows];
    for (std::size_t d = 0; d < 3; ++d) y[d * kernel::kTileRows] = 0;
  }
  return bad;
}

}  // namespace

template <typename Value>
Result<std::vector<double>> Projector::project(std::span<const Value> positions) const {
  const std::size_t n = asset_->vertex_count, r = asset_->rank;
  if (positions.size() != 3 * n) {
    return fail(ErrorCode::kInvalidArgument, "positions: " + std::to_string(positions.size()) +
                                                 " values, the asset has " + std::to_string(n) +
                                                 " vertices and needs 3 for each");
  }
  constexpr std::size_t kRows = kForwardTiles * kernel::kTileRows;
  const std::size_t parts = (n + kRows - 1) / kRows;
  struct Part {
    std::vector<double> sums;
    std::size_t bad = kNone;
  };
  std::vector<Part> done(parts);
  const kernel::Functions& functions = kernel::functions(set_);
  const auto sum_part = [&](std::size_t part) {
    const std::size_t first = part * kRows, rows = std::min(kRows, n - first);
    const std::size_t tiles = (rows + kernel::kTileRows - 1) / kernel::kTileRows;
    std::vector<float> Y(tiles * 3 * kernel::kTileRows);
    AlignedVector<float> scratch(3 * r * kernel::kWidestVector);
    done[part].sums.resize(3 * r);
    done[part].bad = weigh(*asset_, weights_, positions, first, rows, Y);
    functions.add_transposed(tiles_.view(part * kForwardTiles, asset_->rank), tiles, Y.data(), done[part].sums.data(),
                             scratch.data());
  };
  if (threads_ == 1) {
    for (std::size_t part = 0; part < parts; ++part) sum_part(part);
  } else {
    worker_team().run(parts, sum_part);
  }

  std::vector<double> C(3 * r);
  std::size_t bad = kNone;
  for (const Part& part : done) {
    bad = std::min(bad, part.bad);
    for (std::size_t i = 0; i < 3 * r; ++i) C[i] += part.sums[i];
  }
  if (bad != kNone) {
    return fail(ErrorCode::kInvalidArgument,
                "positions: vertex " + std::to_string(bad) + " has a coordinate that is not a finite number");
  }
  for (std::uint32_t k = 0; k < asset_->rank; ++k) {
    for (std::size_t d = 0; d < 3; ++d) C[3 * k + d] *= static_cast<double>(tiles_.scale(k));
  }
  solve(gram_factor_, r, C);
  return C;
}

Result<Projector> Projector::create(const Asset& asset, InstructionSet set, unsigned threads) {
  assert(asset.complete());
  Projector projector;
  projector.asset_ = &asset;
  projector.set_ = set;
  projector.threads_ = threads;
  projector.tiles_.update(asset);
  projector.weights_ = weights_of(asset);
  projector.gram_factor_ = gram_matrix(asset, projector.weights_, kernel::functions(set));
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
  return project(positions);
}

Result<std::vector<double>> Projector::coefficients_from_positions(std::span<const double> positions) const {
  return project(positions);
}

}  // namespace eigencast
