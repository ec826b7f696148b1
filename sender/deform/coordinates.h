// SPDX-License-Identifier: MIT
#pragma once

#include <span>

#include "common/surface/surface.h"

/// What a point inside a cage is made of. The cage is as cage_from_mesh gives it.
namespace eigencast::deform {

/// Green coordinates of one point: p = sum phi_i v_i + sum psi_j s_j n_j, after Lipman, Levin and Cohen-Or, "Green
/// Coordinates", 2008, in closed form over triangles: psi_j is the potential of face j, phi_i that of its dipole layer,
/// each split in edge terms and a solid angle. s_j (see stretches) is 1 at rest. Shapes keep their angles: exact for
/// similarities, not for other affine maps.
///   phi  V, written: one for each vertex
///   psi  F, written: one for each face
/// For points strictly inside; finite everywhere, but not coordinates outside or on the cage.
void green_coordinates(const Surface& cage, const Vec3& point, std::span<double> phi, std::span<double> psi);

/// Mean value coordinates of one point: p = sum w_i v_i, after Ju, Schaefer and Warren, "Mean Value Coordinates for
/// Closed Triangular Meshes", 2005. Exact for affine maps; outside too; negative in the reach of concave parts.
///   w  V, written; sums to 1
void mean_value_coordinates(const Surface& cage, const Vec3& point, std::span<double> w);

/// s_j n_j of a deformed cage (F x 3): the normal of each face times how much the face is stretched, after Lipman et
/// al.
///   rest   the cage at rest
///   moved  V x 3; a face that has no area there gets no normal
std::vector<Vec3> stretched_normals(const Surface& rest, std::span<const Vec3> moved);

}  // namespace eigencast::deform
