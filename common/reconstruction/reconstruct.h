// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "common/asset/asset.h"
#include "common/reconstruction/basis_tiles.h"

namespace eigencast {

class CornerNormals;

/// One pose to rebuild.
///   C          r x channels, row-major; only the first three columns are used
///   positions  room for N x 3 floats, row-major
///   normals    the same, where has_detail(): unit normals of the surface at full detail; or empty
struct PoseToRebuild {
  std::span<const double> C;
  std::uint32_t channels = 3;
  std::span<float> positions;
  std::span<float> normals{};
};

/// X = Psi C, the hot kernel: follows an asset as it arrives, and rebuilds all poses of a call in one pass over the
/// basis. Where the asset has detail (see DetailKind) two more such products give each vertex the frame of its offset.
/// A vertex is the same at every level. rebuild() is thread-safe without a concurrent update(), and uses the process's
/// threads.
class Reconstructor {
 public:
  /// threads: 0 as many as pay (default), 1 the caller's only.
  explicit Reconstructor(InstructionSet set = instruction_sets().back(), unsigned threads = 0)
      : set_(set), threads_(threads) {}

  /// Takes the rows that have arrived since the last call; always call it with the same asset, grown. Costs n x r once.
  void update(const Asset& asset);
  /// Takes memory for all rows of the basis at once, before the first update().
  void reserve(const Asset& asset) { tiles_.reserve(asset); }
  void reset() { tiles_ = {}, detail_ = {}; }  ///< Forgets the asset, before following another.
  const BasisTiles& tiles() const { return tiles_; }
  bool has_detail() const { return detail_.rows() > 0; }

  /// The first N rows from the first `rank` columns; may skip the rows before `first`. Differs from the sum in double
  /// by at most 1e-6 of the sum of its terms' magnitudes; rounding coefficients to 16 bits adds at most 3 % to the
  /// error of the basis (BasisTiles::whole_coefficients). REQUIRES: N <= tiles().rows(), rank <= tiles().rank(), each
  /// C.size() >= rank * channels, channels >= 3.
  void rebuild(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N,
               std::uint32_t first = 0) const;
  void rebuild(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
               std::span<float> positions) const;
  /// Psi C alone, without detail: for values on a surface. As rebuild().
  void combine(std::span<const double> C, std::uint32_t channels, std::uint32_t rank, std::uint32_t N,
               std::span<float> values) const;

 private:
  void run(std::span<const PoseToRebuild> poses, std::uint32_t rank, std::uint32_t N, std::uint32_t first,
           bool with_detail) const;

  InstructionSet set_;
  unsigned threads_;
  BasisTiles tiles_;
  DetailTiles detail_;
};

/// Psi C once: the positions of one pose without detail.
/// REQUIRES: N <= asset.rows_ready, and as Reconstructor::rebuild.
void positions_from_coefficients(const Asset& asset, std::span<const double> C, std::uint32_t channels,
                                 std::uint32_t rank, std::uint32_t N, std::span<float> positions);

/// The triangles of level N: 3 indices each, all below N. Point clouds give none.
/// REQUIRES: asset.base_count <= N <= asset.rows_ready.
std::vector<std::uint32_t> triangles_at_level(const Asset& asset, std::uint32_t N);

/// Area-weighted vertex normals of unit length; zero where a vertex has no face.
///   normals  room for as many floats as positions
void vertex_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles,
                    std::span<float> normals);

/// The same in two parts: sums the normals of each vertex' faces, each twice as long as the face's area;
void area_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles, std::span<float> sums);
/// with corners that have other normals than their vertices' first: `triangles` holds numbers of normals, and `extras`
/// takes the sums of all above;
void area_normals(std::span<const float> positions, std::span<const std::uint32_t> triangles,
                  const CornerNormals& corners, std::span<float> sums, std::span<float> extras);
/// scales vectors of three to unit length, zero vectors excepted.
void normalise(std::span<float> vectors);

/// Unit normals of a point cloud's discs in the pose of `positions` (the first rows), which turn with the frames of the
/// asset's splats. Zero without splats.
///   normals  room for as many floats as positions
void splat_normals(const Asset& asset, std::span<const float> positions, std::span<float> normals);

/// Radii of a point cloud's discs at level N, at rest, into room for N; 0 without splats. O(N).
/// REQUIRES: asset.base_count <= N <= asset.rows_ready.
void splat_radii(const Asset& asset, std::uint32_t N, std::span<float> radii);

/// The level nearest to a fraction of the vertices that is drawable now: clamp(round(fraction n), base_count,
/// rows_ready).
std::uint32_t level_from_fraction(const Asset& asset, double fraction);

/// Projects positions on the receivers' basis: C = (Psi^T W Psi)^-1 Psi^T W X, where Psi is the asset's float basis and
/// W the square root of the mass matrix, between the best fit of the area and that of the vertices (docs/adr/0004). The
/// Gram matrix also corrects for the quantisation of the basis.
/// Thread-safe; uses the process's threads. Setting up costs n r^2 / 2 multiplications once, and memory as BasisTiles
/// says.
class Projector {
 public:
  /// REQUIRES: asset.complete(); keeps a reference, so the asset must outlive it. Errors: kNumerical (Gram matrix not
  /// positive).
  static Result<Projector> create(const Asset& asset, InstructionSet set = instruction_sets().back(),
                                  unsigned threads = 0);

  /// positions: n x 3, in the *source's* vertex order, in the source's space. Returns r x 3, row-major.
  /// Errors: kInvalidArgument (size; a value that is not finite, naming the vertex).
  Result<std::vector<double>> coefficients_from_positions(std::span<const float> positions) const;
  Result<std::vector<double>> coefficients_from_positions(std::span<const double> positions) const;
  /// The same for vectors, such as velocities or scalars, which have no origin to subtract.
  Result<std::vector<double>> coefficients_from_vectors(std::span<const float> vectors) const;
  Result<std::vector<double>> coefficients_from_vectors(std::span<const double> vectors) const;

 private:
  Projector() = default;
  template <typename Value>
  Result<std::vector<double>> project(std::span<const Value> positions, const std::array<double, 3>& origin) const;

  const Asset* asset_ = nullptr;
  BasisTiles tiles_;
  InstructionSet set_ = InstructionSet::kBaseline;
  unsigned threads_ = 0;
  std::vector<double> weights_;  ///< W, by row.
  std::vector<double> inverse_;  ///< Inverse of the Gram matrix' Cholesky factor: r rows, padded to whole tiles.
};

}  // namespace eigencast
