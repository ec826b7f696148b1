// SPDX-License-Identifier: MIT
#pragma once

#include <Eigen/SparseCore>
#include <span>
#include <utility>
#include <vector>

#include "common/surface/surface.h"

namespace eigencast {

/// The component of each vertex, numbered from 0 by its lowest vertex. A vertex without edges is a component.
struct ComponentLabels {
  std::vector<std::uint32_t> of_vertex;
  std::uint32_t count = 0;
};
ComponentLabels components_from_pattern(const Eigen::SparseMatrix<double>& L);

/// Vertex pairs that join all components into one: each component, but the largest, to its 3 nearest vertices of
/// others, then the same with the joined ones, until one remains. Checks at most 4,096 vertices of a component, evenly
/// spread.
std::vector<std::pair<std::uint32_t, std::uint32_t>> find_bridges(std::span<const Vec3> positions,
                                                                  ComponentLabels labels);

}  // namespace eigencast
