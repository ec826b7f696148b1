// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string_view>

#include "common/asset/asset.h"
#include "sender/deform/deformer.h"

namespace eigencast::deform {

/// Vertices of the model that a handle holds.
using HandleGroup = std::vector<std::uint32_t>;

/// Errors: kUnsupported (no faces), kInvalidArgument (no handle, an empty one, a vertex in two of them or not in the
/// model), naming the handle.
Result<void> check_handles(const std::vector<HandleGroup>& groups, std::size_t vertices, std::size_t faces);

/// The centres of what they hold. REQUIRES: check_handles() has passed them.
std::vector<Vec3> centres_of(const std::vector<HandleGroup>& groups, std::span<const Vec3> positions);

/// After Sorkine and Alexa, "As-Rigid-As-Possible Surface Modeling", 2007: each handle carries its vertices by its own
/// shift, the others follow so that neighbourhoods turn rather than stretch, weighed by cotangents. Starts from its
/// last pose: small steps of a hand give a converged shape, a jump takes several poses.
///   groups      the handles are centres_of() them
///   iterations  of a pose, 1 to 100
/// Errors: those of check_handles(); kInvalidArgument: a part without a handle, naming a vertex; kNumerical.
Result<std::unique_ptr<Deformer>> arap_deformer(const Surface& model, std::vector<HandleGroup> groups,
                                                int iterations = 5);

/// {"handles": [[0, 5, 7], {"low": [x, y, z], "high": [x, y, z]}]}: vertices, or a box of them. Errors: kCorrupt.
Result<std::vector<HandleGroup>> handle_groups_from_json(std::string_view text, const Surface& model);

/// Deforms as arap_deformer, but among the shapes of the asset's basis: the unknowns are coefficients, and one rotation
/// serves the vertices around a sample (after Jacobson, Baran, Kavan, Popovic and Sorkine, "Fast Automatic Skinning
/// Transformations", 2012). A pose costs products of r, whatever the number of vertices. Handles are held by weight,
/// not exactly; a part of the mesh that none holds stays where it is.
///   asset   complete, of the model; keeps a reference
///   groups  in the source's numbers
/// Errors: those of check_handles(); kNumerical.
Result<std::unique_ptr<Deformer>> reduced_arap_deformer(const Asset& asset, const std::vector<HandleGroup>& groups,
                                                        int iterations = 8);

}  // namespace eigencast::deform
