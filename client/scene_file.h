// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "view/scene.h"

namespace eigencast {

struct SceneDescription {
  std::vector<std::string> streams;   ///< URLs, names at a context's broker, or "file:INPUT", each once.
  std::vector<Placement> placements;  ///< Empty: one for each stream.
  bool row = true;                    ///< See Scene.
};

/// Reads a scene file's text (client/README.md). Errors: kCorrupt, naming the surface and the member; kTooLarge (more
/// than kMaxSurfaces).
inline constexpr std::size_t kMaxSurfaces = 256;
Result<SceneDescription> scene_from_json(std::string_view text);

/// Errors: kIo, kNotFound as well.
Result<SceneDescription> read_scene_file(const std::string& path);

}  // namespace eigencast
