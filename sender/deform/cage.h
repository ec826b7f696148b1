// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <memory>
#include <span>

#include "common/core/result.h"
#include "common/surface/surface.h"
#include "sender/deform/deformer.h"

/// Cages around models, and what points in a cage, as cage_from_mesh gives it, are made of.
namespace eigencast::deform {

/// Cages are small by nature: a person moves their vertices.
inline constexpr std::size_t kMaxCageVertices = 20'000;

/// A mesh as a cage: closed, manifold, oriented; parts that are inside out are turned. Errors: kInvalidArgument.
Result<Surface> cage_from_mesh(Surface mesh);

/// A cage made from a model: closed, outward, smooth, nowhere nearer to the model than half a cube. The model is
/// rasterised in cubes, `resolution` along its longest side; those that it touches and their neighbours are the inside,
/// caves filled, the corners then smoothed. Distant parts get a cage each.
///   resolution  1 to 64
/// Errors: kInvalidArgument (resolution; a model without extent), kTooLarge (more than kMaxCageVertices).
Result<Surface> cage_around(const Surface& model, int resolution);

/// 1 inside, 0 outside, a fraction on it: the sum of signed solid angles by van Oosterom and Strackee, "The Solid Angle
/// of a Plane Triangle", 1983.
double winding_number(const Surface& cage, const Vec3& point);

enum class CageCoordinates { kGreen, kMeanValue };

/// The handles are the cage's vertices, the map is that of its coordinates. Costs n x (V + F) terms once, on the
/// process's threads; W takes as many doubles (n x V for mean values).
///   progress  fraction in [0, 1]; returns false to cancel; null: none
/// Errors: kInvalidArgument: vertices not inside the cage (Green); kTooLarge: W of more than 2 GiB; kCancelled.
Result<std::unique_ptr<Deformer>> cage_deformer(const Surface& model, Surface cage, CageCoordinates coordinates,
                                                const std::function<bool(double)>& progress = {});

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
