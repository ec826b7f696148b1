// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// For each of n vertices the number of its component, from 0, when `edges` join them; a vertex without edges is a
/// component. Numbers grow with the lowest vertex of the component. The second value is how many components there are.
struct ComponentLabels {
  std::vector<std::uint32_t> of_vertex;
  std::uint32_t count = 0;
};
ComponentLabels components_from_pattern(const Eigen::SparseMatrix<double>& L);
ComponentLabels components_from_faces(std::size_t n, std::span<const Face> faces);

/// Vertex pairs that join all components into one: each component, but the largest, to its 3 nearest vertices of
/// others, then the same with what that joined, until one is left. Looks at no more than 4,096 vertices of a component,
/// evenly spread.
std::vector<std::pair<std::uint32_t, std::uint32_t>> find_bridges(std::span<const Vec3> positions,
                                                                  ComponentLabels labels);

}  // namespace eigencast
