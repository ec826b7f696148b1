// SPDX-License-Identifier: MIT
#include "client/viewer_state.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <span>
#include <system_error>

#include "common/core/text.h"
#include "common/reconstruction/reconstruct.h"

namespace eigencast {
namespace {

std::string on_off(bool on) {
  return on ? "on" : "off";
}

constexpr std::array<const char*, 3> kPlayoutTexts{"as they come", "interpolated here", "estimated here"};

void toggle(bool& value) {
  value = !value;
}

void change_playout(PlayoutSettings& playout) {
  playout.mode = next_of(playout.mode, 3);
  playout.smoothness.reset();
  playout.delay_us = 0;
}

constexpr Modifiers kShift{true, false}, kControl{false, true};
constexpr std::array<KeyCommand, 35> kCommands{
    {{"R Home", [](const KeyTarget& on) { on.camera.home(); }},
     {"H F1", [](const KeyTarget& on) { toggle(on.state.help); }},
     {"X", [](const KeyTarget& on) { toggle(on.state.style.axes); }},
     {"G", [](const KeyTarget& on) { toggle(on.state.style.grid); }},
     {"E", [](const KeyTarget& on) { toggle(on.state.style.edges); }},
     {"P", [](const KeyTarget& on) { toggle(on.state.style.points); }},
     {"W", [](const KeyTarget& on) { toggle(on.state.style.wireframe); }},
     {"N", [](const KeyTarget& on) { on.state.style.normals = next_of(on.state.style.normals, kNormalsKinds); }},
     {"V", [](const KeyTarget& on) { ++on.state.colourings_on; }},
     {"C", [](const KeyTarget& on) { on.state.style.colour_map = next_of(on.state.style.colour_map, kColourMaps); }},
     {"B", [](const KeyTarget& on) { toggle(on.state.style.legend); }},
     {"F", [](const KeyTarget& on) { toggle(on.state.hud); }},
     {"S F12", [](const KeyTarget& on) { on.state.screenshot_wanted = true; }},
     {"+ =", [](const KeyTarget& on) { on.lod.finer(); }, {}, true},
     {"-", [](const KeyTarget& on) { on.lod.coarser(); }, {}, true},
     {".", [](const KeyTarget& on) { ++on.state.steps; }, {}, true},
     {",", [](const KeyTarget& on) { --on.state.steps; }, {}, true},
     {"M", [](const KeyTarget& on) { change_playout(on.state.playout); }},
     {"]", [](const KeyTarget& on) { on.state.speed = next_speed(on.state.speed, true); }},
     {"[", [](const KeyTarget& on) { on.state.speed = next_speed(on.state.speed, false); }},
     {"L", [](const KeyTarget& on) { toggle(on.state.looping); }},
     {"End", [](const KeyTarget& on) { on.state.live_wanted = true; }},
     {"Space", [](const KeyTarget& on) { toggle(on.state.paused); }},
     {"U", [](const KeyTarget& on) { on.camera.set_up(next_of(on.camera.up(), 3)); }},
     {"A", [](const KeyTarget& on) { on.state.resolver_wanted = true; }},
     {"Tab", [](const KeyTarget& on) { toggle(on.state.panel); }},
     {"Y", [](const KeyTarget& on) { toggle(on.state.turntable); }},
     {"K", [](const KeyTarget& on) { toggle(on.state.recording); }},
     {"T", [](const KeyTarget& on) { on.state.pin_wanted = true; }},
     {"O", [](const KeyTarget& on) { on.state.lead_wanted = true; }},
     {"J", [](const KeyTarget& on) { on.state.follow_wanted = true; }},
     {"S F12", [](const KeyTarget& on) { on.state.clean_screenshot_wanted = true; }, kShift},
     {"C", [](const KeyTarget& on) { on.state.copy_wanted = true; }, kControl},
     {"V", [](const KeyTarget& on) { on.state.paste_wanted = true; }, kControl},
     {"Escape Q", [](const KeyTarget& on) { on.state.quit = true; }}}};

bool names(std::string_view keys, std::string_view key) {
  const std::vector<std::string_view> list = split(keys, ' ');
  return std::find(list.begin(), list.end(), key) != list.end();
}

struct Ray {
  glm::vec3 from{0}, to{0};  ///< Towards `to`, not unit length: parameters are the same in every space.
};

glm::vec3 vertex(std::span<const float> positions, std::size_t i) {
  return {positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
}

/// Moeller, Trumbore 1997, "Fast, minimum storage ray-triangle intersection"; both sides count.
struct Along {
  float t = 0;
  glm::vec3 weights{1, 0, 0};
};
std::optional<Along> hit_triangle(const Ray& ray, const glm::vec3& a, const glm::vec3& b, const glm::vec3& c) {
  const glm::vec3 along = ray.to - ray.from, ab = b - a, ac = c - a, p = glm::cross(along, ac);
  const float determinant = glm::dot(ab, p);
  if (determinant == 0) return std::nullopt;
  const glm::vec3 s = ray.from - a, q = glm::cross(s, ab);
  const float u = glm::dot(s, p) / determinant, v = glm::dot(along, q) / determinant;
  const float t = glm::dot(ac, q) / determinant;
  if (u < 0 || v < 0 || u + v > 1 || t <= 0) return std::nullopt;
  return Along{t, {1 - u - v, u, v}};
}

std::optional<Along> hit_point(const Ray& ray, const glm::vec3& point, float radius) {
  const glm::vec3 along = ray.to - ray.from;
  const float t = glm::dot(point - ray.from, along) / glm::dot(along, along);
  if (t <= 0 || glm::length(ray.from + t * along - point) > radius) return std::nullopt;
  return Along{t};
}

}  // namespace

const KeyCommand* command_for_key(std::string_view key, const Modifiers& modifiers) {
  const bool shift = modifiers.shift && !modifiers.control && (key == "S" || key == "F12");
  const auto command = std::find_if(kCommands.begin(), kCommands.end(), [&](const KeyCommand& c) {
    return names(c.keys, key == " " ? "Space" : key) && c.modifiers.control == modifiers.control &&
           c.modifiers.shift == shift;
  });
  return command == kCommands.end() ? nullptr : &*command;
}

std::vector<HelpLine> help_lines(const ViewerState& state, const Camera& camera, const LevelOfDetail& lod,
                                 ResolverKind resolver) {
  const std::string up(1, static_cast<char>('X' + static_cast<int>(camera.up())));
  return {{"left drag", "rotate", ""},
          {"right or middle drag, Shift+left", "pan", ""},
          {"wheel", "zoom to the cursor", ""},
          {"double click", "turn round the point that was hit", ""},
          {"R  Home", "reset the camera", ""},
          {"+ -", "level of detail, at most", formatted("%.3g %%", 100 * lod.fraction())},
          {"A", "what lowers it to hold the rate", std::string(kResolverNames[resolver])},
          {"Space", "pause", on_off(state.paused)},
          {",  .", "one pose back, on, of what is kept", ""},
          {"[  ]", "slower, faster", formatted("x%.3g", state.speed)},
          {"L", "loop", on_off(state.looping)},
          {"End", "to live; of a file to the last pose", ""},
          {"M", "motion between poses", kPlayoutTexts[static_cast<std::size_t>(state.playout.mode)]},
          {"V", "what colours say", title_of(state.style.colour)},
          {"C", "colour map", std::string(kColourMapNames[state.style.colour_map])},
          {"B", "its legend", on_off(state.style.legend)},
          {"N", "normals", std::string(kNormalsNames[state.style.normals])},
          {"E", "edges", on_off(state.style.edges)},
          {"W", "wireframe", on_off(state.style.wireframe)},
          {"P", "points", on_off(state.style.points)},
          {"G", "ground grid", on_off(state.style.grid)},
          {"X", "axes", on_off(state.style.axes)},
          {"U", "up axis", up},
          {"Tab", "panel: surfaces, style, motion, plots", on_off(state.panel)},
          {"F", "figures", on_off(state.hud)},
          {"S  F12", "screenshot; with Shift without background", ""},
          {"Y", "turntable", on_off(state.turntable)},
          {"K", "write every picture", on_off(state.recording)},
          {"Ctrl+C  Ctrl+V", "copy the camera; paste a camera, a URL or a path", ""},
          {"T  O  J", "in a room: pin the panel's note here, lead, follow; again: stop", ""},
          {"H  F1", "this help", on_off(state.help)},
          {"Q  Esc", "quit", ""}};
}

std::string next_free_name(const std::string& prefix, const std::string& ending) {
  for (int number = 1; number < 10'000; ++number) {
    std::error_code error;
    const std::string name = prefix + formatted("_%04d", number) + ending;
    if (!std::filesystem::exists(name, error)) return name;
  }
  return prefix + "_9999" + ending;
}

std::optional<Hit> pick(const Scene& scene, const Camera& camera, const glm::vec2& at_px, int width_px, int height_px,
                        std::span<PoseSource* const> whole) {
  if (width_px < 1 || height_px < 1) return std::nullopt;
  const glm::mat4 scene_from_clip = glm::inverse(camera.clip_from_view() * camera.view_from_scene());
  const glm::vec4 far = scene_from_clip * glm::vec4(2 * at_px.x / static_cast<float>(width_px) - 1,
                                                    1 - 2 * at_px.y / static_cast<float>(height_px), 0.5F, 1);
  const Ray in_scene{camera.position(), glm::vec3(far) / far.w};
  std::optional<Hit> nearest;
  float nearest_t = 0;
  std::vector<float> room;
  for (std::size_t surface = 0; surface < scene.instances().size(); ++surface) {
    const Scene::Instance& instance = scene.instances()[surface];
    const auto take = [&](const std::optional<Along>& hit, const std::array<std::uint32_t, 3>& rows) {
      if (!hit || (nearest && hit->t >= nearest_t)) return;
      nearest_t = hit->t;
      nearest = Hit{in_scene.from + hit->t * (in_scene.to - in_scene.from), surface, rows, hit->weights};
    };
    const SurfaceGeometry& g = instance.view.geometry();
    if (!instance.visible || g.vertex_count() == 0) continue;
    const Asset* asset = whole.empty() ? nullptr : whole[instance.placement.source]->asset();
    const std::span<const float> X =
        asset != nullptr ? instance.view.whole_positions(room) : instance.view.positions(room);
    const auto N = static_cast<std::uint32_t>(X.size() / 3);
    const std::vector<std::uint32_t> triangles = asset != nullptr ? triangles_at_level(*asset, N) : g.triangles;
    const glm::mat4 surface_from_scene = glm::inverse(instance.scene_from_surface);
    const Ray ray{glm::vec3(surface_from_scene * glm::vec4(in_scene.from, 1)),
                  glm::vec3(surface_from_scene * glm::vec4(in_scene.to, 1))};
    for (std::uint32_t i = 0; g.is_point_cloud && i < N; ++i)
      take(hit_point(ray, vertex(X, i), 1.2F * g.point_spacing), {i, i, i});
    for (std::size_t f = 0; f + 2 < triangles.size(); f += 3) {
      const std::array<std::uint32_t, 3> rows{triangles[f], triangles[f + 1], triangles[f + 2]};
      take(hit_triangle(ray, vertex(X, rows[0]), vertex(X, rows[1]), vertex(X, rows[2])), rows);
    }
  }
  return nearest;
}

}  // namespace eigencast
