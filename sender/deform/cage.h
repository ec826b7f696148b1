// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/core/result.h"
#include "common/surface/surface.h"

namespace eigencast::deform {

/// Cages are small by nature: a person moves their vertices.
inline constexpr std::size_t kMaxCageVertices = 20'000;

/// Makes a mesh usable as a cage: closed, every edge between two faces that run along it in opposite directions, each
/// part with an outward side; parts that are inside out are turned. Errors: kInvalidArgument, saying what is wrong.
Result<Surface> cage_from_mesh(Surface mesh);

/// A cage made from a model: closed, outward, smooth, and strictly around it. The model is rasterised in cubes, as many
/// along its longest side as `resolution` says; those that it touches and their neighbours are the cage's inside, caves
/// filled. Its corners are then smoothed by less than half a cube, so that no point of it comes nearer to the model
/// than half a cube: what is guaranteed is strict containment with that distance. A model of distant parts gets a cage
/// for each.
///   resolution  1 to 64
/// Errors: kInvalidArgument (resolution; a model without extent), kTooLarge (more than kMaxCageVertices).
Result<Surface> cage_around(const Surface& model, int resolution);

/// How often a closed surface winds round a point: 1 inside, 0 outside, a fraction on it (generalised winding number:
/// the sum of signed solid angles by van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", 1983).
double winding_number(const Surface& cage, const Vec3& point);

}  // namespace eigencast::deform
