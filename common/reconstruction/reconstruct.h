// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"

namespace eigencast {

/// X = Psi C for the first N rows: the hot kernel.
///   C          r x channels, row-major, as float or double; only the first three columns are used
///   positions  room for N x 3 floats, row-major
///   rank       use only the first `rank` columns of the basis (<= asset.rank), as for a receiver of fewer bands
/// Thread-safe: reads the asset only. REQUIRES: N <= asset.rows_ready, C.size() >= rank * channels.
void positions_from_coefficients(const Asset& asset, std::span<const double> C, std::uint32_t channels, std::uint32_t rank,
                                 std::uint32_t N, std::span<float> positions);

/// The triangles of level N: 3 indices each, all below N. Point clouds give none.
/// REQUIRES: asset.base_count <= N <= asset.rows_ready.
std::vector<std::uint32_t> triangles_at_level(const Asset& asset, std::uint32_t N);

/// Area-weighted vertex normals (unit length; zero where a vertex has no face).
///   normals  room for as many floats as positions
void vertex_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles, std::span<float> normals);

/// The level nearest to a fraction of the vertices that is drawable now: clamp(round(fraction n), base_count, rows_ready).
std::uint32_t level_from_fraction(const Asset& asset, double fraction);

/// Projects positions on the basis that receivers have: C = (Psi^T M Psi)^-1 Psi^T M X, where Psi is the asset's float basis; the
/// Gram matrix corrects what quantising the basis did to its orthonormality.
///
/// Thread-safe after construction. Setting up costs n r^2 / 2 multiplications once.
class Projector {
 public:
  /// REQUIRES: asset.complete(); keeps a reference, so the asset must outlive it. Errors: kNumerical (Gram matrix not positive).
  static Result<Projector> create(const Asset& asset);

  /// positions: n x 3 (any float type), in the *source's* vertex order, in the source's space. Returns r x 3, row-major.
  /// Errors: kInvalidArgument (size; a value that is not finite, naming the vertex).
  Result<std::vector<double>> coefficients_from_positions(std::span<const float> positions) const;
  Result<std::vector<double>> coefficients_from_positions(std::span<const double> positions) const;

 private:
  Projector() = default;
  const Asset* asset_ = nullptr;
  std::vector<double> gram_factor_;  ///< Lower Cholesky factor, r x r.
};

}  // namespace eigencast
