// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// Vertices of a triangle.
using Corners = std::array<std::uint32_t, 3>;

/// How an image lies on the faces of a surface. A wedge is a UV of a vertex; along seams a vertex has several. Wedges
/// are numbered by vertex, and contract as vertices do: with the first N vertices a corner has the wedge that is found
/// from its own by following `parent` until it is below first_wedge[N]. So both sides of a seam stay apart.
struct AssetTexture {
  static constexpr std::size_t kMaxImageBytes = std::size_t{16} << 20;
  static constexpr std::array<std::uint16_t, 2> kNone{65535, 65535};  ///< A wedge that is not in the image.

  std::vector<std::uint32_t> first_wedge;         ///< n + 1.
  std::vector<std::array<std::uint16_t, 2>> uvs;  ///< W: on a grid of 65535 steps from low to high (65534: high).
  std::array<float, 2> low{0, 0}, high{1, 1};
  std::vector<std::uint32_t> parent;  ///< W: a wedge of map[i] for those of i >= q; itself below q.
  std::vector<Corners> corners;       ///< F: the wedges of each face's corners.
  Bytes image;                        ///< A PNG or JPEG file.

  /// In the image: (0, 0) is the upper left corner of its first pixel, (1, 1) the lower right one of its last; beyond
  /// it repeats. REQUIRES: uvs[wedge] != kNone.
  std::array<float, 2> uv(std::uint32_t wedge) const;
  /// At most 1e30, and low <= high.
  bool has_finite_box() const;
};

/// The step of the grid from low to high that is nearest. REQUIRES: low <= value <= high.
std::uint16_t texture_grid(float value, float low, float high);

/// How far a surface at a level of detail is from itself with all vertices, over the diagonal of the rest box: from
/// vertices to the nearest point of what is drawn, at rest and in poses that the baker was given.
struct GeometricError {
  std::uint32_t rows = 0;  ///< The level.
  float rms = 0;           ///< Over vertices by their masses, and poses.
  float largest = 0;
  bool operator==(const GeometricError&) const = default;
};

/// What an asset's manifest states of it.
struct AssetFacts {
  enum class UpAxis : std::uint8_t { kUnknown, kX, kY, kZ };
  enum class Handedness : std::uint8_t { kRight, kLeft };

  std::uint32_t vertex_count = 0;           ///< n
  std::uint32_t rank = 0;                   ///< r
  std::uint32_t base_count = 0;             ///< q
  std::uint32_t face_total = 0;             ///< F of the finished asset.
  std::string basis_kind = "augmented";     ///< "harmonic", "augmented", ...: for people, no arithmetic depends on it.
  std::string operator_kind = "cotangent";  ///< Whose eigenvectors, and masses, these are: for people, too.
  std::vector<std::uint32_t> band_ends;
  std::vector<double> rest;  ///< r x 3, row-major: coefficients of the rest pose.
  double area = 0;           ///< trace M
  UpAxis up_axis = UpAxis::kY;
  Handedness handedness = Handedness::kRight;
  double metres_per_unit = 0;                   ///< 0 = unknown
  std::array<double, 3> box_low{}, box_high{};  ///< Bound the rest pose.
  std::array<double, 3> origin{};  ///< Where the asset's zero lies in the source's space: source = asset + origin.
  std::string name;
  std::vector<GeometricError> level_errors;  ///< By rows, ascending from q, all below n; at n it is 0. Empty: unknown.

  bool is_point_cloud() const { return face_total == 0; }
  double diagonal() const;  ///< The rest box's.
  bool operator==(const AssetFacts&) const = default;
};

/// What a receiver needs to rebuild a surface from coefficients, and a sender to project on it. Rows (vertices) are in
/// level-of-detail order: see progressive/prefix.h for map, faces and death.
///
/// While it is arriving (see AssetReader) its arrays hold the first `rows_ready` vertices and the `faces_ready` faces
/// that exist at that level, with their corners there: a smaller asset that is whole in itself.
struct Asset : AssetFacts {
  /// Psi, n x r, as receivers have it. Its first float_columns() are floats; the later ones are 16-bit integers times
  /// their column's scale, as the asset's bytes hold them. One that is not encoded yet has floats alone.
  std::vector<float> floats;                 ///< n x float_columns(), row-major.
  std::vector<std::int16_t> integers;        ///< n x (r - float_columns()), row-major.
  std::vector<float> column_scales;          ///< r - float_columns()
  std::vector<float> mass;                   ///< n: diagonal of M.
  std::vector<std::uint32_t> map;            ///< n
  std::vector<Corners> faces;                ///< F, by death; empty = point cloud.
  std::vector<std::uint32_t> death;          ///< F, ascending.
  std::vector<std::uint32_t> source_vertex;  ///< n: the number that row i has in the source (a permutation).

  /// How to draw points as discs (progressive/splats.h says what each array holds). Normals are within a degree, radii
  /// rounded up by a twenty-second at most.
  struct Splats {
    std::vector<std::array<std::uint32_t, 2>> frame;
    std::vector<std::array<float, 3>> normal;
    std::vector<float> radius, parent_radius;

    std::size_t size() const { return frame.size(); }
    void append(const Splats& more);
    void resize(std::size_t rows);
  };
  Splats splats;  ///< n or nothing

  /// What the basis leaves out of the rest pose, and how it comes back in every other (asset/detail.h): for each row
  /// the derivatives of the basis' columns along two tangents; an offset from where the basis puts the vertex and the
  /// surface's normal at rest, in the frame that those tangents span in the pose at hand.
  struct Detail {
    std::uint32_t axes = 3;                      ///< 3; 1: offsets are along z, the frame's normal, alone.
    std::vector<float> steps;                    ///< r: what one unit in a column of the next two is.
    std::vector<std::int16_t> along_x, along_y;  ///< n x r, row-major; no units for vertices without neighbours.
    std::vector<std::array<float, 3>> offset;    ///< n
    std::vector<std::array<float, 3>> normal;    ///< n, of unit length.
    float unit = 0;                              ///< Scales offsets, as the asset's bytes hold them.

    std::size_t size() const { return offset.size(); }
  };
  Detail detail;                                     ///< n or nothing
  std::vector<std::array<std::uint8_t, 3>> colours;  ///< n or nothing: of the vertices, sRGB.
  /// n or nothing: whether the source's own normals at a vertex are none (0); one, so that it is smooth (1); or
  /// several, so that its edges are hard (2).
  std::vector<std::uint8_t> normals;
  static constexpr std::uint8_t kNormalsValues = 3;
  std::shared_ptr<const AssetTexture> texture;  ///< Null where there is none, and until all chunks are there.

  /// What quantising may move vertices by (rms, model units) for the wish that it was baked for; 0: none. A sender's
  /// affair: known where it was baked, found in the cache, or read from a folder.
  double coding_error = 0;

  std::uint32_t rows_ready = 0;   ///< Vertices whose rows, map and mass have arrived and were verified.
  std::uint32_t faces_ready = 0;  ///< Faces with death < rows_ready, all there.

  std::uint32_t float_columns() const { return rank - static_cast<std::uint32_t>(column_scales.size()); }
  float entry(std::size_t row, std::size_t column) const {
    const std::size_t count = float_columns();
    if (column < count) return floats[row * count + column];
    const std::size_t integer = column - count;
    return static_cast<float>(integers[row * column_scales.size() + integer]) * column_scales[integer];
  }
  /// Copies a row of Psi. REQUIRES: to.size() == rank.
  void copy_row(std::size_t row, std::span<float> to) const;

  bool complete() const { return vertex_count > 0 && rows_ready == vertex_count; }
};

/// Checks n, r, q and F. Errors: kCorrupt, naming the first offender; kTooLarge (over asset_limits.h).
Result<void> check_counts(const AssetFacts& facts);
/// check_counts, bands, finite numbers, lengths of texts. Errors: as check_counts.
Result<void> check_facts(const AssetFacts& facts);
/// Checks a finished asset: shapes, ranges, permutation, map[i] < i, death ascending, finite numbers. Errors: as
/// check_counts.
Result<void> validate_asset(const Asset& asset);
/// Checks a texture against its finished asset. Errors: as check_counts.
Result<void> validate_texture(const AssetTexture& texture, const Asset& asset);

}  // namespace eigencast
