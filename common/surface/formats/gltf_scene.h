// SPDX-License-Identifier: MIT
#pragma once

#include "common/core/result.h"
#include "common/surface/formats/gltf_accessor.h"
#include "common/surface/formats/gltf_pose.h"

/// Private to common/surface.
namespace eigencast {

/// Errors: kCorrupt, kUnsupported (nothing that can be drawn), kTooLarge.
Result<GltfScene> gltf_scene_from_model(const tinygltf::Model& model, GltfNumbers& numbers);

}  // namespace eigencast
