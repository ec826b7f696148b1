// SPDX-License-Identifier: MIT
#pragma once

#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "view/camera.h"
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

/// A flight of the camera over time: a non-uniform Catmull-Rom spline through the keys, whose velocities are those of
/// the parabolas through three neighbours.
class CameraPath {
 public:
  struct Key {
    double seconds = 0;
    glm::vec3 eye{0}, target{0};
  };

  /// Reads {"keys": [{"t": 0, "eye": [x, y, z], "target": [x, y, z]}, ...]}, t in seconds from 0, ascending.
  /// Errors: kCorrupt, naming the key; kTooLarge (over 10,000 keys).
  static Result<CameraPath> from_json(std::string_view text);
  /// Nothing for an empty path. Errors: kIo as well.
  static Result<std::optional<CameraPath>> read(const std::string& path);
  /// REQUIRES: at least one key, times ascending.
  explicit CameraPath(std::vector<Key> keys);

  double seconds() const { return keys_.back().seconds; }
  /// Before the first and after the last key the camera stays there.
  void apply(double seconds, Camera& camera) const;
  Key at(double seconds) const;

 private:
  glm::vec3 along(glm::vec3 Key::*member, std::size_t i, double seconds) const;
  std::vector<Key> keys_;
};

/// Writes a key of a path, for the clipboard.
std::string text_from_camera(const Camera& camera);
/// Moves the camera to such a key, or to the first key of a whole path; false if the text is neither.
bool camera_from_text(std::string_view text, Camera& camera);

}  // namespace eigencast
