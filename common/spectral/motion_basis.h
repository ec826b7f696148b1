// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/basis.h"
#include "common/spectral/known_motion.h"

namespace eigencast {

/// A basis for a known motion: the constant, x0, y0, z0, so that every affine image of the rest pose is exact; then
/// M-orthonormal columns, each prefix the best of its length:
///   given columns   their span beyond the affine ones, ordered by the variance of the poses, then by the columns' reach.
///                   Poses made of the columns are exact to float rounding, if all fit in `rank`.
///   no columns      the principal components of the poses' coordinates (Alexa & Mueller 2000, "Representing Animations
///                   by Principal Components")
/// Columns that depend on others to a relative 3e-7 are dropped. Poses are read once, one by one; the principal
/// components of the poses so far are updated for about forty poses at a time
/// (Levy & Lindenbaum 2000, "Sequential Karhunen-Loeve Basis Extraction and its Application to Images"), so that memory
/// does not grow with the clip. Errors: kInvalidArgument (no columns and fewer than two poses; columns or poses of
/// another surface), kNumerical, kCancelled, kTooLarge; those of the poses.
Result<Basis> build_motion_basis(const Surface& rest, const Laplacian& laplacian, const KnownMotion& motion, int rank,
                                 const Progress& progress = {});

}  // namespace eigencast
