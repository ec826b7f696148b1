// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <memory>

#include "sender/deform/deformer.h"

namespace eigencast::deform {

enum class CageCoordinates { kGreen, kMeanValue };

/// The handles are the cage's vertices, the map is that of its coordinates. Costs n x (V + F) terms once, on the process's
/// threads; W takes as many doubles (n x V for mean values).
///   progress  fraction in [0, 1]; returns false to cancel; null: none
/// Errors: kInvalidArgument: vertices not inside the cage (Green); kTooLarge: W of more than 2 GiB; kCancelled.
Result<std::unique_ptr<Deformer>> cage_deformer(const Surface& model, Surface cage, CageCoordinates coordinates,
                                                const std::function<bool(double)>& progress = {});

}  // namespace eigencast::deform
