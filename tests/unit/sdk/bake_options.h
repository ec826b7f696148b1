// SPDX-License-Identifier: MIT
#pragma once

#include "sdk/bake.h"

namespace eigencast {

inline BakeOptions of_rank(int rank, BasisKind basis = BasisKind::kAugmented) {
  return {basis, rank, "test"};
}

}  // namespace eigencast
