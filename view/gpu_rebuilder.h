// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/result.h"
#include "view/rebuild.h"

namespace eigencast {

/// Rebuilds on the GPU with OpenGL 3.3 core: a pose is its coefficients (12 bytes each), positions and normals never
/// leave it. They differ from those of CpuRebuilder by rounding: positions by 2e-6 of the sum of their terms' sizes (of a
/// moving vertex: or of its parents' largest such sum), and by what CpuRebuilder alone rounds coefficients to 16 bits
/// (BasisTiles::whole_coefficients); normals by 0.1 degrees where the surface has any area.
///
/// A surface too large for the GPU's buffers, or with detail (DetailKind), is rebuilt on the processor, without `gpu`.
///
/// The OpenGL context of its creation must be current in every call, and when it and the surfaces that it has rebuilt
/// are destroyed. Not thread-safe. finish: wait for the GPU after each part, so that costs are those of the work.
/// Errors: kUnsupported (OpenGL below 3.3), kInternal (a shader does not compile).
Result<std::unique_ptr<SurfaceRebuilder>> make_gpu_rebuilder(bool finish = false);

}  // namespace eigencast
