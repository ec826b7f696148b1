// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

struct TriedRank {
  int rank = 0;      ///< That it has; less than asked for where the surface has too few vertices.
  double error = 0;  ///< Rms error that it leaves on the sample poses, over the diagonal.
};

struct RankChoice {
  TriedRank chosen;
  std::vector<TriedRank> tried;           ///< In order of rank.
  std::string text(double target) const;  ///< What was chosen and why, in a line.
};

/// A small rank whose error is not above `target`: ranks are doubled until one does, then what lies between is searched,
/// where errors fall as powers of the rank, until a sixteenth is left. Each try is a bake.
/// Errors: those of error_of; kInvalidArgument where the largest rank, or that of the surface, does not do.
Result<RankChoice> choose_rank(double target, int largest, const std::function<Result<TriedRank>(int rank)>& error_of);

}  // namespace eigencast
