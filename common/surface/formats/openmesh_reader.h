// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/result.h"
#include "common/surface/formats/guard.h"
#include "common/surface/surface.h"

/// Private to common/surface.
namespace eigencast {

enum class MeshFormat { kObj, kOff, kPly, kStl };

/// Lets OpenMesh read a guarded file; n-gons are split in fans. What it read is held against what the guard read: the
/// positions are then the guard's doubles. STL's triangles share a vertex where they have the same position, and those
/// that have no three corners left are gone.
/// Errors: kInternal (OpenMesh read something else than the guard), kTooLarge (memory).
/// Thread-safe: OpenMesh's readers keep state, so that one call runs at a time.
Result<Surface> surface_from_guarded(const GuardedMesh& mesh, MeshFormat format);

}  // namespace eigencast
