// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <vector>

#include "common/core/result.h"
#include "common/spectral/shift_invert.h"

namespace eigencast {

/// Some eigenpairs of S: column j of `vectors` (orthonormal to the tolerance) goes with values[j]; ascending. Zero
/// columns fill the last panel.
struct EigenPairs {
  Eigen::VectorXd values;
  Panels vectors;
};

/// The `count` eigenpairs nearest to the operator's sigma, in the complement of the panels that `deflated` names:
/// Lanczos by blocks of eight (Golub & Underwood 1977, "The block Lanczos method for computing eigenvalues"), every
/// block orthogonalised against all before, restarted from Ritz vectors when the subspace gets too large (Wu & Simon
/// 2000, "Thick-restart Lanczos method for large symmetric eigenvalue problems"). It may miss copies of an eigenvalue
/// of multiplicity above eight, which inertia reveals. Same seed, same result.
/// REQUIRES: 1 <= count < n - deflated columns. Errors: kNumerical. Lets exceptions of the operator's callback through.
Result<EigenPairs> nearest_eigenpairs(ShiftInvert& op, int count, std::uint32_t seed,
                                      const std::vector<const Panels*>& deflated);

/// About how many columns the subspace needs for `count` pairs, to plan memory and time.
int expected_subspace(int count);

}  // namespace eigencast
