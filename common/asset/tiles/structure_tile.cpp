// SPDX-License-Identifier: MIT
#include <algorithm>
#include <bit>
#include <cmath>
#include <optional>
#include <string>

#include "common/asset/tiles/number_coder.h"
#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

/// Kinds of numbers, in the order in which they come.
enum : std::size_t {
  kParent,
  kSource,
  kMass,
  kDeaths,
  kOrder,
  kThird,
  kCorner,
  kNewMove,
  kOldMove,
  kPredictors,
  kPredictor,
  kWeight,
  kStructureKinds
};

constexpr std::uint32_t kAnyOrder = 6;

/// Which new rows a vertex becomes as they arrive: those that contract onto it, one after the other.
class Arrivals {
 public:
  /// new_map: of rows first_row .. end_row; a row of the base is its own. REQUIRES: no entry above its row.
  Arrivals(std::uint32_t first_row, std::span<const std::uint32_t> new_map)
      : begin_(first_row + new_map.size() + 1, 0), at_(begin_.size() - 1), size_(at_.size(), 0) {
    const auto for_each_child = [&](const auto& visit) {
      for (std::uint32_t k = 0; k < new_map.size(); ++k) {
        if (new_map[k] != first_row + k) visit(first_row + k, new_map[k]);
      }
    };
    for_each_child([&](std::uint32_t child, std::uint32_t parent) { size_[child] = 1, ++begin_[parent + 1]; });
    for (std::size_t k = new_map.size(); k-- > 0;) {
      if (new_map[k] != first_row + k) size_[new_map[k]] += size_[first_row + k];
    }
    for (std::size_t v = 1; v < begin_.size(); ++v) begin_[v] += begin_[v - 1];
    children_.resize(begin_.back());
    rows_.resize(begin_.back());
    std::vector<std::uint32_t> slot(begin_.begin(), begin_.end() - 1), next(at_.size());
    std::uint32_t roots_end = 0;
    for (std::uint32_t v = 0; v < at_.size(); ++v) {
      const bool is_root = v < first_row || new_map[v - first_row] == v;
      if (is_root) at_[v] = next[v] = roots_end, roots_end += size_[v];
    }
    for_each_child([&](std::uint32_t child, std::uint32_t parent) {
      children_[slot[parent]++] = child;
      at_[child] = next[parent];
      next[parent] += size_[child];
      next[child] = at_[child] + 1;
      rows_[at_[child]] = child;
    });
  }

  /// The rows from `level` on that are v at that level. REQUIRES: v < level, first_row <= level.
  std::span<const std::uint32_t> of(std::uint32_t v, std::uint32_t level) const {
    const auto end = children_.begin() + begin_[v + 1];
    const auto first = std::lower_bound(children_.begin() + begin_[v], end, level);
    if (first == end) return {};
    return std::span(rows_).subspan(at_[*first], at_[v] + size_[v] - at_[*first]);
  }

 private:
  std::vector<std::uint32_t> begin_, children_;  // of each vertex, ascending
  std::vector<std::uint32_t> at_, size_;         // each new row's place in rows_, and how many begin there with it
  std::vector<std::uint32_t> rows_;              // children behind their parents
};

/// A corner that is v at `level` and goes on from there to the chunk's last level: 0 stays, else one of the arrivals.
void write_move(NumberWriter& out, std::size_t kind, const Arrivals& arrivals, std::uint32_t v, std::uint32_t level,
                std::uint32_t corner) {
  const auto rows = arrivals.of(v, level);
  if (rows.empty()) return;
  const auto at = corner == v ? 0 : std::find(rows.begin(), rows.end(), corner) - rows.begin() + 1;
  out.pass(kind, static_cast<std::uint32_t>(at));
}
std::optional<std::uint32_t> read_move(NumberReader& in, std::size_t kind, const Arrivals& arrivals, std::uint32_t v,
                                       std::uint32_t level) {
  const auto rows = arrivals.of(v, level);
  const std::uint32_t move = rows.empty() ? 0 : in.pass(kind);
  if (move > rows.size()) return std::nullopt;
  return move == 0 ? v : rows[move - 1];
}

/// Where the corners of a face that dies at a row stand: the row's, its parent's, the third.
std::array<std::size_t, 3> places_of(std::uint32_t order) {
  const std::size_t a = order / 2, b = (a + 1 + order % 2) % 3;
  return {a, b, 3 - a - b};
}

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

std::int32_t bits_of(float mass) {
  return std::bit_cast<std::int32_t>(mass);
}

class Decoder {
 public:
  Decoder(ByteView coded, const ChunkRange& range, std::uint32_t new_faces, const EarlierStructure& earlier)
      : in_(coded, kStructureKinds), range_(range), new_faces_(new_faces), earlier_(earlier) {}

  Result<void> rows() {
    const std::uint32_t count = range_.end_row - range_.first_row;
    tile_.map.reserve(count);
    for (std::uint32_t i = range_.first_row; i < range_.end_row; ++i) {
      const std::uint32_t up = i < range_.base_count ? 0 : in_.pass(kParent);
      if (i >= range_.base_count && (up == 0 || up > i))
        return corrupt_structure("the parent of row " + std::to_string(i) + " is out of range");
      tile_.map.push_back(i - up);
    }
    tile_.source_vertex.reserve(count);
    tile_.mass.reserve(count);
    for (std::uint32_t i = range_.first_row; i < range_.end_row; ++i) {
      const std::int64_t reference = reference_row(i, tile_.map[i - range_.first_row], range_.base_count);
      const std::int64_t predicted = reference < 0 ? 0 : row_of(earlier_.source_vertex, tile_.source_vertex, reference);
      const std::int64_t source = predicted + in_.pass_signed(kSource);
      if (source < 0 || source >= range_.vertex_count)
        return corrupt_structure("the source of row " + std::to_string(i) + " is out of range");
      tile_.source_vertex.push_back(static_cast<std::uint32_t>(source));
      const float near = reference < 0 ? 1.0F : row_of(earlier_.mass, tile_.mass, reference);
      const auto bits = static_cast<std::uint32_t>(bits_of(near)) + static_cast<std::uint32_t>(in_.pass_signed(kMass));
      const auto mass = std::bit_cast<float>(bits);
      if (!std::isfinite(mass) || mass <= 0)
        return corrupt_structure("the mass of row " + std::to_string(i) + " is not positive");
      tile_.mass.push_back(mass);
    }
    return {};
  }

  Result<void> faces() {
    tile_.death.reserve(new_faces_);
    for (std::uint32_t i = range_.first_row; i < range_.end_row && tile_.death.size() < new_faces_; ++i) {
      const std::uint32_t dying = in_.pass(kDeaths);
      if (dying > new_faces_ - tile_.death.size()) return corrupt_structure("more faces than the manifest says");
      tile_.death.insert(tile_.death.end(), dying, i);
    }
    if (tile_.death.size() < new_faces_) return corrupt_structure("fewer faces than the manifest says");
    tile_.faces.reserve(new_faces_);
    const Arrivals arrivals(range_.first_row, tile_.map);
    for (std::uint32_t f = 0; f < new_faces_; ++f) {
      const auto face = new_face(arrivals, tile_.death[f]);
      if (!face) return corrupt_structure("a corner of new face " + std::to_string(f) + " is out of range");
      if ((*face)[0] == (*face)[1] || (*face)[1] == (*face)[2] || (*face)[2] == (*face)[0])
        return corrupt_structure("new face " + std::to_string(f) + " repeats a corner");
      tile_.faces.push_back(*face);
    }
    tile_.old_faces.assign(earlier_.faces.begin(), earlier_.faces.end());
    for (Corners& face : tile_.old_faces) {
      for (std::uint32_t& corner : face) {
        const auto moved = read_move(in_, kOldMove, arrivals, corner, range_.first_row);
        if (!moved) return corrupt_structure("a face moves to a vertex that does not exist");
        corner = *moved;
      }
    }
    return {};
  }

  Result<void> predictors() {
    Predictors& all = tile_.predictors;
    const std::uint32_t count = range_.end_row - range_.first_row;
    all.first.reserve(count + 1);
    for (std::uint32_t row = range_.first_row; row < range_.end_row; ++row) {
      const std::uint32_t many = in_.pass(kPredictors);
      if (many > Predictors::kMaxPerRow) return corrupt_structure("too many predictors of a row");
      for (std::uint32_t at = 0; at < many; ++at) {
        const std::uint32_t back = in_.pass(kPredictor);
        if (back == 0 || back > row)
          return corrupt_structure("a predictor of row " + std::to_string(row) + " does not come before it");
        all.rows.push_back(row - back);
        const std::int32_t weight = in_.pass_signed(kWeight);
        if (weight < -Predictors::kMaxWeight || weight > Predictors::kMaxWeight)
          return corrupt_structure("a weight is out of range");
        all.weights.push_back(static_cast<std::int16_t>(weight));
      }
      all.end_row();
    }
    if (!in_.coder().finished()) return corrupt_structure("bytes too many at its end");
    return {};
  }

  StructureTile take() && { return std::move(tile_); }

 private:
  std::optional<Corners> new_face(const Arrivals& arrivals, std::uint32_t death) {
    Corners face{};
    const std::uint32_t order = in_.pass(kOrder);
    if (order > kAnyOrder || (order < kAnyOrder && death < range_.base_count)) return std::nullopt;
    if (order == kAnyOrder) {
      for (std::uint32_t& corner : face) {
        corner = in_.pass(kCorner);
        if (corner >= range_.end_row) return std::nullopt;
      }
      return face;
    }
    const std::uint32_t third = in_.pass(kThird);
    if (third == 0 || third > death) return std::nullopt;
    const Corners stood{death, tile_.map[death - range_.first_row], death - third};
    const auto places = places_of(order);
    for (std::size_t k = 0; k < 3; ++k) {
      const auto corner = read_move(in_, kNewMove, arrivals, stood[k], death + 1);
      if (!corner) return std::nullopt;
      face[places[k]] = *corner;
    }
    return face;
  }

  NumberReader in_;
  ChunkRange range_;
  std::uint32_t new_faces_;
  const EarlierStructure& earlier_;
  StructureTile tile_;
};

/// REQUIRES: v < end_row of the tile.
class Encoder {
 public:
  Encoder(Bytes& out, const ChunkRange& range, const StructureTile& tile, const EarlierStructure& earlier)
      : out_(out, kStructureKinds),
        range_(range),
        tile_(tile),
        earlier_(earlier),
        arrivals_(range.first_row, tile.map) {}

  void encode() {
    rows();
    std::size_t f = 0;
    for (std::uint32_t i = range_.first_row; i < range_.end_row && f < tile_.death.size(); ++i) {
      const std::size_t first = f;
      while (f < tile_.death.size() && tile_.death[f] == i) ++f;
      out_.pass(kDeaths, static_cast<std::uint32_t>(f - first));
    }
    for (f = 0; f < tile_.faces.size(); ++f) new_face(tile_.faces[f], tile_.death[f]);
    for (f = 0; f < earlier_.faces.size(); ++f) {
      for (std::size_t k = 0; k < 3; ++k)
        write_move(out_, kOldMove, arrivals_, earlier_.faces[f][k], range_.first_row, tile_.old_faces[f][k]);
    }
    const Predictors& all = tile_.predictors;
    for (std::uint32_t i = 0; i < all.row_count(); ++i) {
      out_.pass(kPredictors, all.first[i + 1] - all.first[i]);
      for (std::uint32_t at = all.first[i]; at < all.first[i + 1]; ++at) {
        out_.pass(kPredictor, range_.first_row + i - all.rows[at]);
        out_.pass_signed(kWeight, all.weights[at]);
      }
    }
    out_.coder().finish();
  }

 private:
  std::uint32_t map_of(std::uint32_t i) const { return tile_.map[i - range_.first_row]; }

  void rows() {
    for (std::uint32_t i = std::max(range_.first_row, range_.base_count); i < range_.end_row; ++i)
      out_.pass(kParent, i - map_of(i));
    for (std::uint32_t i = range_.first_row; i < range_.end_row; ++i) {
      const std::int64_t reference = reference_row(i, map_of(i), range_.base_count);
      const auto source = static_cast<std::int32_t>(row_of(earlier_.source_vertex, tile_.source_vertex, i));
      const auto predicted =
          static_cast<std::int32_t>(reference < 0 ? 0 : row_of(earlier_.source_vertex, tile_.source_vertex, reference));
      out_.pass_signed(kSource, source - predicted);
      const float near = reference < 0 ? 1.0F : row_of(earlier_.mass, tile_.mass, reference);
      out_.pass_signed(kMass, bits_of(row_of(earlier_.mass, tile_.mass, i)) - bits_of(near));
    }
  }

  /// A face that dies at a row has it and its parent for corners until then.
  void new_face(const Corners& face, std::uint32_t death) {
    const bool is_of_base = death < range_.base_count;
    Corners stood = face;
    for (std::uint32_t& corner : stood) {
      while (!is_of_base && corner > death) corner = map_of(corner);
    }
    for (std::uint32_t order = is_of_base ? kAnyOrder : 0; order < kAnyOrder; ++order) {
      const auto [a, b, third] = places_of(order);
      if (stood[a] != death || stood[b] != map_of(death) || stood[third] >= death) continue;
      out_.pass(kOrder, order);
      out_.pass(kThird, death - stood[third]);
      for (const std::size_t k : {a, b, third}) write_move(out_, kNewMove, arrivals_, stood[k], death + 1, face[k]);
      return;
    }
    out_.pass(kOrder, kAnyOrder);
    for (const std::uint32_t corner : face) out_.pass(kCorner, corner);
  }

  NumberWriter out_;
  const ChunkRange& range_;
  const StructureTile& tile_;
  const EarlierStructure& earlier_;
  Arrivals arrivals_;
};

}  // namespace

Bytes encode_structure(const ChunkRange& range, const StructureTile& tile, const EarlierStructure& earlier) {
  Bytes coded;
  Encoder(coded, range, tile, earlier).encode();
  return coded;
}

Result<StructureTile> decode_structure(ByteView coded, const ChunkRange& range, std::uint32_t new_faces,
                                       const EarlierStructure& earlier) {
  Decoder decoder(coded, range, new_faces, earlier);
  Result<void> result = decoder.rows();
  if (result) result = decoder.faces();
  if (result) result = decoder.predictors();
  if (!result) return result.error();
  return std::move(decoder).take();
}

}  // namespace eigencast
