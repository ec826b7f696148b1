// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/core/result.h"
#include "common/surface/appearance.h"
#include "common/surface/surface.h"

namespace eigencast {

/// Reads one surface. Vertices keep the file's order and number, n-gons are split in fans, nothing is merged or dropped
/// (but see parse_stl). OBJ, PLY, OFF, STL, XYZ (x y z [nx ny nz] a line), NPY ((n,3), or the first frame of (T,n,3)),
/// PC2 and MDD (first frame, no faces), glTF (see open_clip). Errors: kNotFound, kIo, kUnsupported (unknown ending),
/// kCorrupt (what is wrong and where), kTooLarge (over limits).
///   appearance  filled with the file's colours and textures; null: unwanted
Result<Surface> read_surface(const std::string& path, Appearance* appearance = nullptr);

}  // namespace eigencast
