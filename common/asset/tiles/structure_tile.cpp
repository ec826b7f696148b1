// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <string>

#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

/// For each vertex below first_row, the new rows that contract onto it at level first_row, ascending.
class Descendants {
 public:
  /// new_map: map of rows first_row .. end_row. REQUIRES: each entry below its own row.
  Descendants(std::uint32_t first_row, std::span<const std::uint32_t> new_map) : begin_(first_row + 1, 0) {
    if (first_row == 0) return;  // Nothing came before; base vertices are their own parents.
    root_.reserve(new_map.size());
    for (const std::uint32_t parent : new_map) root_.push_back(parent < first_row ? parent : root_[parent - first_row]);
    for (const std::uint32_t root : root_) ++begin_[root + 1];
    for (std::uint32_t v = 0; v < first_row; ++v) begin_[v + 1] += begin_[v];
    rows_.resize(root_.size());
    std::vector<std::uint32_t> at(begin_.begin(), begin_.end() - 1);
    for (std::uint32_t i = 0; i < root_.size(); ++i) rows_[at[root_[i]]++] = first_row + i;
  }

  std::span<const std::uint32_t> of(std::uint32_t v) const {
    return std::span(rows_).subspan(begin_[v], begin_[v + 1] - begin_[v]);
  }

 private:
  std::vector<std::uint32_t> root_;   // per new row
  std::vector<std::uint32_t> begin_;  // per earlier vertex, into rows_
  std::vector<std::uint32_t> rows_;
};

/// The row that predicts row i: its parent, or in the base the row before; -1 where there is none.
std::int64_t reference_row(std::uint32_t i, std::uint32_t map_of_i, std::uint32_t base_count) {
  return i < base_count ? std::int64_t{i} - 1 : std::int64_t{map_of_i};
}

/// Rows of an array of which a first part came with earlier chunks.
template <typename T>
T row_of(std::span<const T> earlier, const std::vector<T>& now, std::int64_t i) {
  const auto at = static_cast<std::size_t>(i);
  return at < earlier.size() ? earlier[at] : now[at - earlier.size()];
}

Error corrupt_structure(const std::string& what) {
  return fail(ErrorCode::kCorrupt, "structure tile: " + what);
}

class Decoder {
 public:
  Decoder(ByteView raw, const ChunkRange& range, std::uint32_t new_faces)
      : in_(raw), range_(range), new_faces_(new_faces) {}

  Result<void> rows(std::span<const std::uint32_t> earlier_source) {
    const std::uint32_t count = range_.end_row - range_.first_row;
    tile_.map.reserve(count);
    for (std::uint32_t i = range_.first_row; i < range_.end_row; ++i) {
      const std::uint64_t up = i < range_.base_count ? 0 : in_.varint();
      if (i >= range_.base_count && (up == 0 || up > i))
        return corrupt_structure("the parent of row " + std::to_string(i) + " is out of range");
      tile_.map.push_back(i - static_cast<std::uint32_t>(up));
    }
    tile_.source_vertex.reserve(count);
    for (std::uint32_t i = range_.first_row; i < range_.end_row; ++i) {
      const std::int64_t reference = reference_row(i, tile_.map[i - range_.first_row], range_.base_count);
      const std::int64_t predicted = reference < 0 ? 0 : row_of(earlier_source, tile_.source_vertex, reference);
      const std::uint64_t code = in_.varint();
      const std::int64_t source = code > (std::uint64_t{1} << 33) ? -1 : predicted + unzigzag(code);
      if (source < 0 || source >= range_.vertex_count)
        return corrupt_structure("the source of row " + std::to_string(i) + " is out of range");
      tile_.source_vertex.push_back(static_cast<std::uint32_t>(source));
    }
    tile_.mass.reserve(count);
    for (std::uint32_t i = 0; i < count; ++i) {
      const float mass = in_.f32();
      if (!std::isfinite(mass) || mass <= 0)
        return corrupt_structure("the mass of row " + std::to_string(range_.first_row + i) + " is not positive");
      tile_.mass.push_back(mass);
    }
    return {};
  }

  Result<void> faces() {
    tile_.death.reserve(new_faces_);
    std::uint64_t death = range_.first_row;
    for (std::uint32_t f = 0; f < new_faces_; ++f) {
      const std::uint64_t step = in_.varint();
      if (step >= range_.end_row - death)
        return corrupt_structure("the death of new face " + std::to_string(f) + " is out of range");
      death += step;
      tile_.death.push_back(static_cast<std::uint32_t>(death));
    }
    tile_.faces.reserve(new_faces_);
    for (std::uint32_t f = 0; f < new_faces_; ++f) {
      Corners face{};
      std::int64_t predicted = tile_.death[f];
      for (std::uint32_t& corner : face) {
        const std::uint64_t code = in_.varint();
        predicted = code > (std::uint64_t{1} << 33) ? -1 : predicted + unzigzag(code);
        if (predicted < 0 || predicted >= range_.end_row)
          return corrupt_structure("a corner of new face " + std::to_string(f) + " is out of range");
        corner = static_cast<std::uint32_t>(predicted);
      }
      if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0])
        return corrupt_structure("new face " + std::to_string(f) + " repeats a corner");
      tile_.faces.push_back(face);
    }
    return {};
  }

  Result<void> moves(std::span<const Corners> earlier_faces) {
    const Descendants descendants(range_.first_row, tile_.map);
    tile_.old_faces.assign(earlier_faces.begin(), earlier_faces.end());
    for (Corners& face : tile_.old_faces) {
      for (std::uint32_t& corner : face) {
        const auto candidates = descendants.of(corner);
        if (candidates.empty()) continue;
        const std::uint64_t move = in_.varint();
        if (move > candidates.size()) return corrupt_structure("a face moves to a vertex that does not exist");
        if (move > 0) corner = candidates[move - 1];
      }
    }
    return {};
  }

  Result<void> predictors() {
    Predictors& all = tile_.predictors;
    const std::uint32_t count = range_.end_row - range_.first_row;
    all.first.reserve(count + 1);
    std::uint32_t end = 0;
    for (std::uint32_t i = 0; i < count; ++i) {
      const std::uint64_t many = in_.varint();
      if (many > Predictors::kMaxPerRow) return corrupt_structure("too many predictors of a row");
      all.first.push_back(end += static_cast<std::uint32_t>(many));
    }
    all.rows.reserve(end);
    for (std::uint32_t i = 0; i < count; ++i) {
      const std::uint32_t row = range_.first_row + i;
      for (std::uint32_t at = all.first[i]; at < all.first[i + 1]; ++at) {
        const std::uint64_t back = in_.varint();
        if (back == 0 || back > row)
          return corrupt_structure("a predictor of row " + std::to_string(row) + " does not come before it");
        all.rows.push_back(row - static_cast<std::uint32_t>(back));
      }
    }
    all.weights.reserve(end);
    for (std::uint32_t at = 0; at < end; ++at) {
      const std::uint64_t code = in_.varint();
      if (code > 2 * std::uint64_t{Predictors::kMaxWeight}) return corrupt_structure("a weight is out of range");
      all.weights.push_back(static_cast<std::int16_t>(unzigzag(code)));
    }
    if (!in_.finished()) return corrupt_structure(in_.failed() ? "ends too early" : "bytes too many at its end");
    return {};
  }

  bool failed() const { return in_.failed(); }
  StructureTile take() && { return std::move(tile_); }

 private:
  ByteReader in_;
  ChunkRange range_;
  std::uint32_t new_faces_;
  StructureTile tile_;
};

}  // namespace

// A varint has 1 to 5 bytes. By row: map (not in the base), source, mass, number of predictors, these; by new face:
// death and corners.
std::uint64_t min_structure_bytes(std::uint64_t rows, std::uint64_t new_faces) {
  return rows * (1 + 4 + 1) + new_faces * (1 + 3);
}

std::uint64_t max_structure_bytes(std::uint64_t rows, std::uint64_t new_faces, std::uint64_t old_faces) {
  return rows * (5 + 5 + 4 + 1 + Predictors::kMaxPerRow * (4 + 2)) + new_faces * (5 + 3 * 5) + old_faces * 3 * 5;
}

Bytes encode_structure(const ChunkRange& range, const StructureTile& tile, std::span<const std::uint32_t> earlier_map,
                       std::span<const std::uint32_t> earlier_source, std::span<const Corners> earlier_faces) {
  Bytes raw;
  ByteWriter out(raw);
  for (std::uint32_t i = std::max(range.first_row, range.base_count); i < range.end_row; ++i) {
    out.varint(i - row_of(earlier_map, tile.map, i));
  }
  for (std::uint32_t i = range.first_row; i < range.end_row; ++i) {
    const std::int64_t reference = reference_row(i, row_of(earlier_map, tile.map, i), range.base_count);
    const std::int64_t predicted = reference < 0 ? 0 : row_of(earlier_source, tile.source_vertex, reference);
    out.varint(zigzag(std::int64_t{row_of(earlier_source, tile.source_vertex, i)} - predicted));
  }
  for (const float mass : tile.mass) out.f32(mass);
  std::uint32_t death = range.first_row;
  for (const std::uint32_t d : tile.death) {
    out.varint(d - death);
    death = d;
  }
  for (std::size_t f = 0; f < tile.faces.size(); ++f) {
    std::int64_t predicted = tile.death[f];
    for (const std::uint32_t corner : tile.faces[f]) {
      out.varint(zigzag(std::int64_t{corner} - predicted));
      predicted = corner;
    }
  }
  const Descendants descendants(range.first_row, tile.map);
  for (std::size_t f = 0; f < earlier_faces.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const auto candidates = descendants.of(earlier_faces[f][k]);
      if (candidates.empty()) continue;
      const std::uint32_t corner = tile.old_faces[f][k];
      const auto at = std::lower_bound(candidates.begin(), candidates.end(), corner);
      const bool moved = at != candidates.end() && *at == corner;
      out.varint(moved ? static_cast<std::uint64_t>(at - candidates.begin()) + 1 : 0);
    }
  }
  const Predictors& predictors = tile.predictors;
  for (std::size_t i = 0; i < predictors.row_count(); ++i) out.varint(predictors.first[i + 1] - predictors.first[i]);
  for (std::size_t i = 0; i < predictors.row_count(); ++i) {
    for (std::uint32_t at = predictors.first[i]; at < predictors.first[i + 1]; ++at)
      out.varint(range.first_row + i - predictors.rows[at]);
  }
  for (const std::int16_t weight : predictors.weights) out.varint(zigzag(weight));
  return raw;
}

Result<StructureTile> decode_structure(ByteView raw, const ChunkRange& range, std::uint32_t new_faces,
                                       std::span<const std::uint32_t> earlier_source,
                                       std::span<const Corners> earlier_faces) {
  Decoder decoder(raw, range, new_faces);
  Result<void> result = decoder.rows(earlier_source);
  if (result) result = decoder.faces();
  if (result) result = decoder.moves(earlier_faces);
  if (result) result = decoder.predictors();
  if (!result) return decoder.failed() ? corrupt_structure("ends too early") : result.error();
  return std::move(decoder).take();
}

}  // namespace eigencast
