// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <memory>

#include "sender/deform/deformer.h"

namespace eigencast::deform {

enum class CageCoordinates { kGreen, kMeanValue };

/// Binds a model to a cage: the handles are the cage's vertices, the map is that of green_coordinates or
/// mean_value_coordinates. Costs n x (V + F) terms once, by the process's threads; W takes as many doubles (n x V for
/// mean values).
///   cage      as cage_from_mesh or cage_around give it
///   progress  fraction in [0, 1]; returns false to cancel; null: none
/// Errors: kInvalidArgument: vertices outside the cage or on it (Green), how many and the first; kTooLarge: W of more
/// than 2 GiB; kCancelled.
Result<std::unique_ptr<Deformer>> cage_deformer(const Surface& model, Surface cage, CageCoordinates coordinates,
                                                const std::function<bool(double)>& progress = {});

}  // namespace eigencast::deform
