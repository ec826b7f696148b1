// SPDX-License-Identifier: MIT
#pragma once

#include <span>

#include "common/surface/surface.h"

/// Of a point in a cage, which is as cage_from_mesh gives it.
namespace eigencast::deform {

/// p = sum phi_i v_i + sum psi_j s_j n_j, after Lipman, Levin and Cohen-Or, "Green Coordinates", 2008, in closed form:
/// psi_j is the potential of face j, phi_i that of its dipole layer. s_j is 1 at rest. Exact for similarities only. For
/// points strictly inside; finite everywhere.
///   phi, psi  V and F, written
void green_coordinates(const Surface& cage, const Vec3& point, std::span<double> phi, std::span<double> psi);

/// p = sum w_i v_i, after Ju, Schaefer and Warren, "Mean Value Coordinates for Closed Triangular Meshes", 2005. Exact
/// for affine maps; outside too; negative in the reach of concave parts.
///   w  V, written; sums to 1
void mean_value_coordinates(const Surface& cage, const Vec3& point, std::span<double> w);

/// s_j n_j of a deformed cage (F x 3): each face's normal times its stretch, after Lipman et al. Zero without area.
std::vector<Vec3> stretched_normals(const Surface& rest, std::span<const Vec3> moved);

}  // namespace eigencast::deform
