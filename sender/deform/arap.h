// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string_view>

#include "sender/deform/deformer.h"

namespace eigencast::deform {

/// Vertices of the model that a handle holds.
using HandleGroup = std::vector<std::uint32_t>;

/// Whether these can be handles of a model. Errors: kUnsupported (without faces), kInvalidArgument (none; an empty one;
/// a vertex in two of them, or not in the model), naming the handle.
Result<void> check_handles(const std::vector<HandleGroup>& groups, std::size_t vertices, std::size_t faces);

/// Where handles are at rest: the centres of what they hold. REQUIRES: check_handles() has passed them.
std::vector<Vec3> centres_of(const std::vector<HandleGroup>& groups, std::span<const Vec3> positions);

/// As rigid as possible, after Sorkine and Alexa, "As-Rigid-As-Possible Surface Modeling", 2007: each handle carries
/// its vertices by its own shift, the others follow so that the neighbourhood of each vertex is turned rather than
/// stretched, weighed by cotangents. Alternates between the best rotations and the best positions, which a factor made
/// once gives. Starts from its last pose: a hand that moves on in small steps gets a converged shape, a jump takes
/// several poses.
///   model       a mesh; rotations near faces without area are as good as their other neighbours make them
///   groups      as check_handles() wants them; the handles are centres_of() them
///   iterations  of a pose, 1 to 100
/// Errors: those of check_handles(); kInvalidArgument: a part of the mesh that no handle holds, naming a vertex of it;
/// kNumerical.
Result<std::unique_ptr<Deformer>> arap_deformer(const Surface& model, std::vector<HandleGroup> groups,
                                                int iterations = 5);

/// {"handles": [[0, 5, 7], {"low": [x, y, z], "high": [x, y, z]}]}: vertices by number, or those in a box. Errors:
/// kCorrupt, saying where and what.
Result<std::vector<HandleGroup>> handle_groups_from_json(std::string_view text, const Surface& model);

}  // namespace eigencast::deform
