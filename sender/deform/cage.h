// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "common/core/result.h"
#include "common/surface/surface.h"
#include "sender/deform/deformer.h"

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

}  // namespace eigencast::deform
