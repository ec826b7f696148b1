// SPDX-License-Identifier: MIT
#include "client/scene_file.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <glm/trigonometric.hpp>
#include <nlohmann/json.hpp>
#include <set>

#include "common/core/files.h"

namespace eigencast {
namespace {

using nlohmann::json;

template <typename Read>
Result<Read> read_json(const std::string& path, Result<Read> (*parse)(std::string_view)) {
  constexpr std::uint64_t kMaxFileBytes = 1 << 20;
  const Result<std::string> text = read_file(path, kMaxFileBytes);
  if (!text) return text.error();
  Result<Read> read = parse(*text);
  return read ? std::move(read) : in_context(path, read.error());
}

/// An array of `count` finite numbers of magnitude up to 1e30. Errors: kCorrupt, beginning with `where`.
Result<std::vector<float>> numbers_from(const json& value, std::size_t count, const std::string& where) {
  if (!value.is_array() || value.size() != count)
    return fail(ErrorCode::kCorrupt, where + ": must be an array of " + std::to_string(count) + " numbers");
  std::vector<float> read;
  for (const json& number : value) {
    const double x = number.is_number() ? number.get<double>() : std::nan("");
    if (!std::isfinite(x) || std::abs(x) > 1e30)
      return fail(ErrorCode::kCorrupt, where + ": holds something that is not a finite number");
    read.push_back(static_cast<float>(x));
  }
  return read;
}

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

Result<CameraPath::Key> key_from(const json& value, const std::string& where) {
  if (!value.is_object() || !value.contains("t") || !value.contains("eye") || !value.contains("target"))
    return fail(ErrorCode::kCorrupt, where + R"(: must be such as {"t": 0, "eye": [0, 1, 3], "target": [0, 0, 0]})");
  const auto t = numbers_from(json::array({value["t"]}), 1, where + ".t");
  if (!t) return t.error();
  const auto eye = numbers_from(value["eye"], 3, where + ".eye");
  if (!eye) return eye.error();
  const auto target = numbers_from(value["target"], 3, where + ".target");
  if (!target) return target.error();
  CameraPath::Key key{
      value["t"].get<double>(), {(*eye)[0], (*eye)[1], (*eye)[2]}, {(*target)[0], (*target)[1], (*target)[2]}};
  if (glm::length(key.eye - key.target) <= 0)
    return wrong(where, "eye and target are the same point, so there is no direction to look in");
  return key;
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
  return read_json(path, scene_from_json);
}

CameraPath::CameraPath(std::vector<Key> keys) : keys_(std::move(keys)) {
  assert(!keys_.empty());
}

Result<CameraPath> CameraPath::from_json(std::string_view text) {
  constexpr std::size_t kMaxKeys = 10'000;
  const json document = json::parse(text, nullptr, false);
  if (!document.is_object() || !document.contains("keys") || !document["keys"].is_array() || document["keys"].empty())
    return fail(ErrorCode::kCorrupt,
                R"(camera path: must be such as {"keys": [{"t": 0, "eye": [0, 1, 3], "target": [0, 0, 0]}]})");
  if (document["keys"].size() > kMaxKeys)
    return fail(ErrorCode::kTooLarge, "camera path: over " + std::to_string(kMaxKeys) + " keys");
  std::vector<Key> keys;
  for (const json& value : document["keys"]) {
    const std::string where = "keys[" + std::to_string(keys.size()) + "]";
    const Result<Key> key = key_from(value, where);
    if (!key) return key.error();
    if (key->seconds < 0 || (!keys.empty() && key->seconds <= keys.back().seconds))
      return fail(ErrorCode::kCorrupt, where + ".t: times must ascend, from 0 on");
    keys.push_back(*key);
  }
  return CameraPath(std::move(keys));
}

Result<std::optional<CameraPath>> CameraPath::read(const std::string& path) {
  if (path.empty()) return std::optional<CameraPath>();
  auto read = read_json(path, from_json);
  if (!read) return read.error();
  return std::optional(std::move(*read));
}

glm::vec3 CameraPath::along(glm::vec3 Key::*member, std::size_t i, double seconds) const {
  const auto time = [&](std::size_t k) { return static_cast<float>(keys_[k].seconds); };
  const auto slope = [&](std::size_t a, std::size_t b) {
    return (keys_[b].*member - keys_[a].*member) / (time(b) - time(a));
  };
  const auto velocity = [&](std::size_t k) {
    if (k == 0) return slope(0, 1);
    if (k + 1 == keys_.size()) return slope(k - 1, k);
    const float before = time(k) - time(k - 1), after = time(k + 1) - time(k);
    return (after * slope(k - 1, k) + before * slope(k, k + 1)) / (before + after);
  };
  const float span = time(i + 1) - time(i);
  const float u = (static_cast<float>(seconds) - time(i)) / span;
  const float v = 1 - u;
  return v * v * ((1 + 2 * u) * (keys_[i].*member) + u * span * velocity(i)) +
         u * u * ((1 + 2 * v) * (keys_[i + 1].*member) - v * span * velocity(i + 1));
}

CameraPath::Key CameraPath::at(double seconds) const {
  if (seconds <= keys_.front().seconds) return keys_.front();
  if (seconds >= keys_.back().seconds) return keys_.back();
  const auto after =
      std::upper_bound(keys_.begin(), keys_.end(), seconds, [](double t, const Key& key) { return t < key.seconds; });
  const auto i = static_cast<std::size_t>(after - keys_.begin()) - 1;
  return {seconds, along(&Key::eye, i, seconds), along(&Key::target, i, seconds)};
}

void CameraPath::apply(double seconds, Camera& camera) const {
  const Key key = at(seconds);
  camera.look_from(key.eye, key.target);
}

std::string text_from_camera(const Camera& camera) {
  const auto list = [](const glm::vec3& v) { return json::array({v.x, v.y, v.z}); };
  return json{{"t", 0}, {"eye", list(camera.position())}, {"target", list(camera.target())}}.dump();
}

bool camera_from_text(std::string_view text, Camera& camera) {
  auto path = CameraPath::from_json(text);
  if (!path) path = CameraPath::from_json("{\"keys\": [" + std::string(text) + "]}");
  if (!path) return false;
  path->apply(0, camera);
  return true;
}

}  // namespace eigencast
