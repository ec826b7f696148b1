// SPDX-License-Identifier: MIT
#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "view/camera.h"
#include "view/scene.h"

namespace eigencast {

/// The nearest point of a visible surface under a pixel: of a mesh where its triangles are hit, of a cloud a point
/// within its spacing.
std::optional<glm::vec3> pick(const Scene& scene, const Camera& camera, const glm::vec2& at_px, int width_px,
                              int height_px);

}  // namespace eigencast
