// SPDX-License-Identifier: MIT
#include "client/camera_path.h"

#include <algorithm>
#include <cassert>
#include <glm/geometric.hpp>
#include <nlohmann/json.hpp>

#include "client/json_file.h"
#include "common/core/files.h"

namespace eigencast {
namespace {

using nlohmann::json;

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
    return fail(ErrorCode::kCorrupt,
                where + ": eye and target are the same point, so there is no direction to look in");
  return key;
}

}  // namespace

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

Result<CameraPath> CameraPath::read(const std::string& path) {
  const Result<std::string> text = read_file(path, kMaxJsonFileBytes);
  if (!text) return text.error();
  Result<CameraPath> read = from_json(*text);
  if (!read) return in_context(path, read.error());
  return read;
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
