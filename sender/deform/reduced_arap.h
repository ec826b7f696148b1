// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/asset/asset.h"
#include "sender/deform/arap.h"

namespace eigencast::deform {

/// As arap_deformer, but among the shapes that the asset's basis has, for a hand that drags: the unknowns are the
/// coefficients, and one rotation serves all the vertices around a sample (after Jacobson, Baran, Kavan, Popovic and
/// Sorkine, "Fast Automatic Skinning Transformations", 2012). All sums over vertices are made once; a pose costs
/// products of r, whatever the number of vertices, and what is sent is the pose itself: coefficients(), no truncation.
/// Handles are held by weight, not exactly; a part of the mesh that none holds stays where it is.
///   asset   complete, of the model; keeps a reference
///   groups  as arap_deformer, in the source's numbers
/// Errors: those of check_handles(); kNumerical.
Result<std::unique_ptr<Deformer>> reduced_arap_deformer(const Asset& asset, const std::vector<HandleGroup>& groups,
                                                        int iterations = 8);

}  // namespace eigencast::deform
