// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/asset/asset.h"
#include "sender/deform/arap.h"

namespace eigencast::deform {

/// As arap_deformer, but among the shapes of the asset's basis: the unknowns are coefficients, and one rotation serves the
/// vertices around a sample (after Jacobson, Baran, Kavan, Popovic and Sorkine, "Fast Automatic Skinning Transformations",
/// 2012). A pose costs products of r, whatever the number of vertices. Handles are held by weight, not exactly; a part of
/// the mesh that none holds stays where it is.
///   asset   complete, of the model; keeps a reference
///   groups  in the source's numbers
/// Errors: those of check_handles(); kNumerical.
Result<std::unique_ptr<Deformer>> reduced_arap_deformer(const Asset& asset, const std::vector<HandleGroup>& groups,
                                                        int iterations = 8);

}  // namespace eigencast::deform
