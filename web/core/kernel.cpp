// SPDX-License-Identifier: MIT
//
// In place of common/reconstruction/kernel.cpp: of its kernels the product alone, pose by pose. What nobody calls is
// not linked.
#define EIGENCAST_VARIANT unused_functions
#include "common/reconstruction/kernel_variant.h"

namespace eigencast::kernel {
namespace {

void product_of_each(const Tiles& tiles, std::size_t rows, const Pose* poses, std::size_t count) {
  for (const Pose* pose = poses; pose != poses + count; ++pose) {
    for (std::size_t tile = 0; tile * kTileRows < rows; ++tile) {
      const std::size_t left = rows - tile * kTileRows, here = left < kTileRows ? left : kTileRows;
      if (pose->whole != nullptr) {
        product_tile<1, true>(tiles, tile, here, pose, 0, 1);
      } else {
        product_tile<1, false>(tiles, tile, here, pose, 0, 1);
      }
    }
  }
}

constexpr Functions kFunctions{product_of_each, nullptr, nullptr, nullptr};

}  // namespace

const Functions& functions(InstructionSet) {
  return kFunctions;
}

}  // namespace eigencast::kernel
