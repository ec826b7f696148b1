// SPDX-License-Identifier: MIT
#include "client/scene_file.h"

#include <algorithm>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <glm/trigonometric.hpp>
#include <nlohmann/json.hpp>
#include <set>

#include "client/json_file.h"
#include "common/core/files.h"

namespace eigencast {
namespace {

using nlohmann::json;

Error wrong(const std::string& where, const std::string& what) {
  return fail(ErrorCode::kCorrupt, where + ": " + what);
}

Result<glm::mat4> transform_of(const json& surface, const std::string& where) {
  glm::mat4 matrix{1};
  if (const auto at = surface.find("position"); at != surface.end()) {
    const auto p = numbers_from(*at, 3, where + ".position");
    if (!p) return p.error();
    matrix = glm::translate(matrix, {(*p)[0], (*p)[1], (*p)[2]});
  }
  if (const auto at = surface.find("rotation_deg"); at != surface.end()) {
    const auto r = numbers_from(*at, 4, where + ".rotation_deg");
    if (!r) return r.error();
    const glm::vec3 axis((*r)[0], (*r)[1], (*r)[2]);
    if (glm::length(axis) < 1e-6F) return wrong(where + ".rotation_deg", "the axis (its first three numbers) is zero");
    matrix = glm::rotate(matrix, glm::radians((*r)[3]), glm::normalize(axis));
  }
  if (const auto at = surface.find("scale"); at != surface.end()) {
    const auto s = numbers_from(json::array({*at}), 1, where + ".scale");
    if (!s) return s.error();
    if ((*s)[0] <= 0) return wrong(where + ".scale", "must be positive");
    matrix = glm::scale(matrix, glm::vec3((*s)[0]));
  }
  return matrix;
}

Result<void> add_surface(const json& surface, const std::string& where, SceneDescription& scene) {
  static const std::set<std::string> kKnown{"stream", "file", "name", "position", "rotation_deg", "scale"};
  if (!surface.is_object()) return wrong(where, "must be an object");
  for (const auto& [key, value] : surface.items()) {
    if (!kKnown.contains(key))
      return wrong(where,
                   "unknown member \"" + key + "\"; there are stream, file, name, position, rotation_deg, scale");
  }
  const auto stream = surface.find("stream"), file = surface.find("file");
  const auto& given = stream != surface.end() ? stream : file;
  if ((stream == surface.end()) == (file == surface.end()) || !given->is_string() || given->get<std::string>().empty())
    return wrong(where, R"(give either a "stream" such as "ws://127.0.0.1:7490/demo" or a "file", as text)");
  const std::string wanted = (given == file ? "file:" : "") + given->get<std::string>();
  const auto name = surface.find("name");
  if (name != surface.end() && !name->is_string()) return wrong(where + ".name", "must be text");
  const Result<glm::mat4> transform = transform_of(surface, where);
  if (!transform) return transform.error();
  auto at = std::find(scene.streams.begin(), scene.streams.end(), wanted);
  if (at == scene.streams.end()) at = scene.streams.insert(at, wanted);
  scene.placements.push_back({static_cast<std::size_t>(at - scene.streams.begin()),
                              name == surface.end() ? std::string() : name->get<std::string>(), *transform});
  return {};
}

}  // namespace

Result<SceneDescription> scene_from_json(std::string_view text) {
  const json document = json::parse(text, nullptr, false);
  if (!document.is_object() || !document.contains("surfaces") || !document["surfaces"].is_array() ||
      document["surfaces"].empty())
    return wrong("scene", R"(must be a JSON object such as {"surfaces": [{"stream": "ws://127.0.0.1:7490/demo"}]})");
  const json& surfaces = document["surfaces"];
  if (surfaces.size() > kMaxSurfaces)
    return fail(ErrorCode::kTooLarge, "scene: " + std::to_string(surfaces.size()) + " surfaces; at most " +
                                          std::to_string(kMaxSurfaces) + " can be shown");
  SceneDescription scene;
  scene.row = false;
  for (std::size_t i = 0; i < surfaces.size(); ++i) {
    if (const auto added = add_surface(surfaces[i], "surfaces[" + std::to_string(i) + "]", scene); !added)
      return added.error();
  }
  return scene;
}

Result<SceneDescription> read_scene_file(const std::string& path) {
  const Result<std::string> text = read_file(path, kMaxJsonFileBytes);
  if (!text) return text.error();
  Result<SceneDescription> scene = scene_from_json(*text);
  if (!scene) return in_context(path, scene.error());
  return scene;
}

}  // namespace eigencast
