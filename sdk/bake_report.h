// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <string>

#include "common/spectral/basis.h"
#include "common/spectral/laplacian.h"
#include "common/surface/surface.h"
#include "sdk/bake.h"

namespace eigencast {

struct BakeFacts {
  const Surface& surface;
  std::size_t poses;  ///< That its levels of detail were made for, beside the rest pose.
  const BakeOptions& options;
  const Laplacian& laplacian;
  const Basis& basis;
  double seconds;
  double bytes;  ///< Of memory.
};

std::string report_of(const BakeResult& result, const BakeFacts& facts);

}  // namespace eigencast
