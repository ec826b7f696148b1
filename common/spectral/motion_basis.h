// SPDX-License-Identifier: MIT
#pragma once

#include "common/spectral/basis.h"
#include "common/spectral/known_motion.h"

namespace eigencast {

/// A basis for a motion that is known. First the constant, so that the barycentre is one coefficient, and what x0, y0,
/// z0 add to it, so that every affine image of the rest pose is exact; then, orthonormal in M and each prefix the best
/// of its length,
///   where columns are given   what they add, in the order of what the poses need of it, and where these need nothing,
///                             of how far the columns go: every pose made of the columns is exact as far as float
///                             columns are (kSpanned; all of them, if there is room for them in `rank`)
///   else                      the principal components of the poses' coordinates (Alexa & Mueller 2000, "Representing
///                             Animations by Principal Components"), kLearned
/// Columns are told apart by a Gram matrix of columns of equal length: what is less than 3e-7 of that is nothing. Poses
/// are read once, one by one; principal components are kept for the poses so far and renewed for about forty at a time
/// (Levy & Lindenbaum 2000, "Sequential Karhunen-Loeve Basis Extraction and its Application to Images"), so that memory
/// does not grow with the clip. Errors: kInvalidArgument (no columns and fewer than two poses; columns or poses of
/// another surface), kNumerical, kCancelled, kTooLarge; those of the poses.
Result<Basis> build_motion_basis(const Surface& rest, const Laplacian& laplacian, const KnownMotion& motion, int rank,
                                 const Progress& progress = {});

}  // namespace eigencast
