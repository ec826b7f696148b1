// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "common/surface/vector.h"
#include "sender/deform/cage.h"

namespace eigencast::deform {
namespace {

constexpr int kPadding = 2;        // empty cubes around the model's
constexpr double kMaxMove = 0.45;  // of a cube, by smoothing
constexpr int kSmoothingRounds = 12;
constexpr int kMaxSplits = 24;

using Cell = std::array<int, 3>;

double longest_side(const Box& box) {
  const Vec3 size = box.high - box.low;
  return *std::max_element(size.begin(), size.end());
}

class Grid {
 public:
  Grid(const Box& box, double side) : side_(side) {
    for (std::size_t c = 0; c < 3; ++c) {
      low_[c] = box.low[c] - kPadding * side;
      counts_[c] = static_cast<int>(std::floor((box.high[c] - box.low[c]) / side)) + 1 + 2 * kPadding;
    }
    solid_.resize(static_cast<std::size_t>(counts_[0]) * static_cast<std::size_t>(counts_[1]) *
                  static_cast<std::size_t>(counts_[2]));
  }
  const Cell& counts() const { return counts_; }
  Vec3 corner(const Cell& cell) const {
    return {low_[0] + side_ * cell[0], low_[1] + side_ * cell[1], low_[2] + side_ * cell[2]};
  }
  Cell cell_of(const Vec3& p) const {
    Cell cell;
    for (std::size_t c = 0; c < 3; ++c) {
      cell[c] = std::clamp(static_cast<int>(std::floor((p[c] - low_[c]) / side_)), 0, counts_[c] - 1);
    }
    return cell;
  }
  bool contains(const Cell& cell) const {
    for (std::size_t c = 0; c < 3; ++c) {
      if (cell[c] < 0 || cell[c] >= counts_[c]) return false;
    }
    return true;
  }
  bool solid(const Cell& cell) const { return contains(cell) && solid_[index(cell)] != 0; }
  void fill(const Cell& cell) { solid_[index(cell)] = 1; }
  /// REQUIRES: `a` and `b` are within.
  void fill_box(const Cell& a, const Cell& b) {
    for_cells(a, b, [&](const Cell& cell) { fill(cell); });
  }
  template <typename Do>
  static void for_cells(const Cell& a, const Cell& b, Do&& act) {
    for (int z = a[2]; z <= b[2]; ++z) {
      for (int y = a[1]; y <= b[1]; ++y) {
        for (int x = a[0]; x <= b[0]; ++x) act(Cell{x, y, z});
      }
    }
  }
  template <typename Do>
  void for_all(Do&& act) const {
    for_cells({0, 0, 0}, {counts_[0] - 1, counts_[1] - 1, counts_[2] - 1}, act);
  }

 private:
  std::size_t index(const Cell& c) const {
    return (static_cast<std::size_t>(c[2]) * static_cast<std::size_t>(counts_[1]) + static_cast<std::size_t>(c[1])) *
               static_cast<std::size_t>(counts_[0]) +
           static_cast<std::size_t>(c[0]);
  }
  double side_;
  Vec3 low_{};
  Cell counts_{};
  std::vector<char> solid_;
};

constexpr std::array<Cell, 6> kSides{{{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}}};

Cell moved(const Cell& cell, const Cell& by) {
  return {cell[0] + by[0], cell[1] + by[1], cell[2] + by[2]};
}

/// The boxes of a triangle's pieces, split at the longest edge until none is larger than a cube, cover it.
void mark_triangle(Grid& grid, const Vec3& a, const Vec3& b, const Vec3& c, double side, int splits) {
  const std::array<Vec3, 3> corners{a, b, c};
  const Box box = bounding_box(corners);
  const double extent = longest_side(box);
  if (extent <= side / 2 || splits == 0) {
    grid.fill_box(grid.cell_of(box.low), grid.cell_of(box.high));
    return;
  }
  std::size_t longest = 0;
  for (std::size_t k = 1; k < 3; ++k) {
    if (length(corners[(k + 1) % 3] - corners[k]) > length(corners[(longest + 1) % 3] - corners[longest])) longest = k;
  }
  const Vec3& p = corners[longest];
  const Vec3& q = corners[(longest + 1) % 3];
  const Vec3& r = corners[(longest + 2) % 3];
  const Vec3 middle = 0.5 * (p + q);
  mark_triangle(grid, p, middle, r, side, splits - 1);
  mark_triangle(grid, middle, q, r, side, splits - 1);
}

Grid dilated(const Grid& grid) {
  Grid wider = grid;
  grid.for_all([&](const Cell& cell) {
    if (grid.solid(cell)) wider.fill_box(moved(cell, {-1, -1, -1}), moved(cell, {1, 1, 1}));
  });
  return wider;
}

void fill_caves(Grid& grid) {
  Grid reached = grid;
  std::vector<Cell> front{{0, 0, 0}};
  reached.fill(front.front());
  while (!front.empty()) {
    const Cell cell = front.back();
    front.pop_back();
    for (const Cell& side : kSides) {
      const Cell next = moved(cell, side);
      if (!reached.contains(next) || reached.solid(next)) continue;
      reached.fill(next);
      front.push_back(next);
    }
  }
  grid.for_all([&](const Cell& cell) {
    if (!reached.solid(cell)) grid.fill(cell);
  });
}

/// Whether the solid cubes of a block of eight are connected by faces.
bool hang_together(unsigned block) {
  if (block == 0) return true;
  unsigned reached = block & (~block + 1);
  for (unsigned before = 0; before != reached;) {
    before = reached;
    for (unsigned i = 0; i < 8; ++i) {
      if ((before >> i & 1) == 0) continue;
      for (const unsigned bit : {1u, 2u, 4u}) reached |= (1u << (i ^ bit)) & block;
    }
  }
  return reached == block;
}

/// Where solid cubes touch in an edge or a corner only, the box around them is filled: the boundary becomes a manifold.
bool fill_pinches(Grid& grid) {
  bool found = false;
  const Cell& counts = grid.counts();
  Grid::for_cells({0, 0, 0}, {counts[0] - 2, counts[1] - 2, counts[2] - 2}, [&](const Cell& cell) {
    unsigned block = 0;
    Cell low{2, 2, 2}, high{-1, -1, -1};
    for (unsigned i = 0; i < 8; ++i) {
      const Cell by{static_cast<int>(i & 1), static_cast<int>(i >> 1 & 1), static_cast<int>(i >> 2 & 1)};
      if (!grid.solid(moved(cell, by))) continue;
      block |= 1u << i;
      for (std::size_t c = 0; c < 3; ++c) {
        low[c] = std::min(low[c], by[c]);
        high[c] = std::max(high[c], by[c]);
      }
    }
    if (hang_together(block) && hang_together(~block & 0xFF)) return;
    grid.fill_box(moved(cell, low), moved(cell, high));
    found = true;
  });
  return found;
}

Surface boundary_of(const Grid& grid) {
  Surface cage;
  std::map<Cell, std::uint32_t> numbers;
  const auto number = [&](const Cell& corner) {
    const auto [at, is_new] = numbers.try_emplace(corner, static_cast<std::uint32_t>(cage.positions.size()));
    if (is_new) cage.positions.push_back(grid.corner(corner));
    return at->second;
  };
  grid.for_all([&](const Cell& cell) {
    if (!grid.solid(cell)) return;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      for (const int side : {0, 1}) {
        Cell beyond = cell;
        beyond[axis] += side == 1 ? 1 : -1;
        if (grid.solid(beyond)) continue;
        std::array<std::uint32_t, 4> quad{};
        for (unsigned k = 0; k < 4; ++k) {
          Cell corner = cell;
          corner[axis] += side;
          corner[(axis + 1) % 3] += k == 1 || k == 2;
          corner[(axis + 2) % 3] += k >= 2;
          quad[k] = number(corner);
        }
        if (side == 0) std::swap(quad[1], quad[3]);
        cage.faces.push_back({quad[0], quad[1], quad[2]});
        cage.faces.push_back({quad[0], quad[2], quad[3]});
      }
    }
  });
  return cage;
}

/// Each vertex stays within a small box around where it was: the surface sweeps over no point that was farther away.
void smooth(Surface& cage, double max_move) {
  const std::vector<Vec3> start = cage.positions;
  for (int round = 0; round < kSmoothingRounds; ++round) {
    std::vector<Vec3> sums(start.size());
    std::vector<double> counts(start.size());
    for (const Face& face : cage.faces) {
      for (std::size_t k = 0; k < 3; ++k) {
        sums[face[k]] = sums[face[k]] + cage.positions[face[(k + 1) % 3]];
        counts[face[k]] += 1;
      }
    }
    for (std::size_t v = 0; v < start.size(); ++v) {
      const Vec3 mean = (1 / counts[v]) * sums[v];
      for (std::size_t c = 0; c < 3; ++c) {
        const double target = 0.5 * (cage.positions[v][c] + mean[c]);
        cage.positions[v][c] = std::clamp(target, start[v][c] - max_move, start[v][c] + max_move);
      }
    }
  }
}

}  // namespace

Result<Surface> cage_around(const Surface& model, int resolution) {
  if (resolution < 1 || resolution > 64) {
    return fail(ErrorCode::kInvalidArgument, "cage resolution " + std::to_string(resolution) + " is not 1 to 64");
  }
  const Box box = bounding_box(model.positions);
  const double extent = longest_side(box);
  if (!(extent > 0) || !std::isfinite(extent)) {
    return fail(ErrorCode::kInvalidArgument, "the model has no extent, so that no cage fits around it");
  }
  const double side = extent / resolution;
  Grid touched(box, side);
  for (const Vec3& p : model.positions) touched.fill(touched.cell_of(p));
  for (const Face& f : model.faces)
    mark_triangle(touched, model.positions[f[0]], model.positions[f[1]], model.positions[f[2]], side, kMaxSplits);
  Grid grid = dilated(touched);
  do {
    fill_caves(grid);
  } while (fill_pinches(grid));
  Surface cage = boundary_of(grid);
  if (cage.vertex_count() > kMaxCageVertices) {
    return fail(ErrorCode::kTooLarge, "a cage of " + std::to_string(cage.vertex_count()) +
                                          " vertices; choose a lower resolution than " + std::to_string(resolution));
  }
  smooth(cage, kMaxMove * side);
  return cage;
}

}  // namespace eigencast::deform
