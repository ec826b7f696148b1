// SPDX-License-Identifier: MIT
#include "sender/studio/hand.h"

#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>
#include <numeric>

#include "common/surface/vector.h"

namespace eigencast::studio {
namespace {

constexpr float kGizmoPx = 90;
constexpr double kMinFactor = 0.02;
constexpr std::array<glm::vec4, 3> kAxisColours{
    {{0.86F, 0.22F, 0.20F, 1}, {0.25F, 0.62F, 0.22F, 1}, {0.20F, 0.40F, 0.85F, 1}}};
constexpr glm::vec4 kCage{0.10F, 0.16F, 0.26F, 0.75F}, kHandle{0.93F, 0.95F, 0.98F, 1}, kChosen{1.0F, 0.70F, 0.12F, 1};

Vec3 vec3_from(const glm::vec3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

Vec3 along(std::size_t axis, double length) {
  Vec3 v{};
  v[axis] = length;
  return v;
}

/// Nothing where they coincide or are behind the camera.
std::optional<glm::vec2> knob_way_px(const Camera& camera, const Gizmo& gizmo, std::size_t axis) {
  const auto from = camera.pixel_from_scene(glm_from(gizmo.centre));
  const auto to = camera.pixel_from_scene(glm_from(gizmo.knob(axis)));
  if (!from || !to || glm::length(*to - *from) < 4) return std::nullopt;
  return *to - *from;
}

/// In lengths of the gizmo. An axis that points at the eye is dragged upwards.
double lengths_along(const Camera& camera, const Gizmo& gizmo, std::size_t axis, const glm::vec2& drag) {
  const auto way = knob_way_px(camera, gizmo, axis);
  if (!way) return -static_cast<double>(drag.y / kGizmoPx);
  return static_cast<double>(glm::dot(drag, *way) / glm::dot(*way, *way));
}

/// The near side follows the mouse.
double turn_about(const Camera& camera, const Gizmo& gizmo, std::size_t axis, const glm::vec2& drag) {
  const auto way = knob_way_px(camera, gizmo, axis);
  const glm::vec2 across = way ? glm::vec2(-way->y, way->x) / glm::length(*way) : glm::vec2(1, 0);
  return std::numbers::pi * static_cast<double>(glm::dot(drag, across) / kHalfTurnPx);
}

/// Bends the longer of the other two axes towards the shorter one.
deform::Frame bent_line(const Box& box, std::size_t axis) {
  const std::size_t u = (axis + 1) % 3, v = (axis + 2) % 3;
  const Vec3 extent = box.high - box.low;
  return extent[u] >= extent[v] ? deform::Frame{u, v} : deform::Frame{v, u};
}

constexpr float kClickPx = 3;

struct Binding {
  std::string_view key;
  Command command;
  bool control = false;
};
constexpr std::array<Binding, 20> kBindings{{{"M", Command::kMove},
                                             {"R", Command::kRotate},
                                             {"S", Command::kScale},
                                             {"T", Command::kTwist},
                                             {"B", Command::kBend},
                                             {"A", Command::kChooseAll},
                                             {"Escape", Command::kChooseNone},
                                             {"Z", Command::kUndo, true},
                                             {"Y", Command::kRedo, true},
                                             {"U", Command::kUndo},
                                             {"Delete", Command::kReset},
                                             {"Home", Command::kHome},
                                             {"V", Command::kShow},
                                             {"C", Command::kCage},
                                             {"E", Command::kEdges},
                                             {"F", Command::kFigures},
                                             {"H", Command::kHelp},
                                             {"F1", Command::kHelp},
                                             {"Q", Command::kQuit},
                                             {"Q", Command::kQuit, true}}};

}  // namespace

glm::vec3 glm_from(const Vec3& p) {
  return {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
}

std::optional<std::uint32_t> handle_at(const Camera& camera, std::span<const Vec3> handles, const glm::vec2& mouse) {
  std::optional<std::uint32_t> best;
  float nearest = 0;
  for (std::uint32_t i = 0; i < handles.size(); ++i) {
    const auto px = camera.pixel_from_scene(glm_from(handles[i]));
    if (!px || glm::length(*px - mouse) > kReachPx) continue;
    const float distance = glm::length(glm_from(handles[i]) - camera.position());
    if (!best || distance < nearest) best = i, nearest = distance;
  }
  return best;
}

std::vector<std::uint32_t> handles_within(const Camera& camera, std::span<const Vec3> handles, const glm::vec2& corner,
                                          const glm::vec2& opposite) {
  const glm::vec2 low = glm::min(corner, opposite), high = glm::max(corner, opposite);
  std::vector<std::uint32_t> within;
  for (std::uint32_t i = 0; i < handles.size(); ++i) {
    const auto px = camera.pixel_from_scene(glm_from(handles[i]));
    if (px && px->x >= low.x && px->x <= high.x && px->y >= low.y && px->y <= high.y) within.push_back(i);
  }
  return within;
}

void frame(Camera& camera, const glm::vec3& low, const glm::vec3& high, std::span<const Vec3> handles) {
  glm::vec3 lowest = low, highest = high;
  for (const Vec3& p : handles) {
    lowest = glm::min(lowest, glm_from(p));
    highest = glm::max(highest, glm_from(p));
  }
  camera.set_scene(lowest, highest);
}

Vec3 shift_in_view(const Camera& camera, const Vec3& point, const glm::vec2& from, const glm::vec2& to) {
  const glm::vec3 eye = camera.position(), ahead = glm::normalize(camera.target() - eye);
  const float depth = glm::dot(glm_from(point) - eye, ahead);
  const auto in_plane = [&](const glm::vec2& px) {
    const glm::vec3 direction = camera.direction_through(px);
    return eye + depth / glm::dot(direction, ahead) * direction;
  };
  return vec3_from(in_plane(to) - in_plane(from));
}

Vec3 Gizmo::knob(std::size_t axis) const {
  return centre + along(axis, length);
}

Gizmo gizmo_at(const Camera& camera, const Vec3& centre) {
  const float distance = std::max(glm::length(glm_from(centre) - camera.position()), 1e-6F * camera.scene_radius());
  const glm::vec3 ahead = camera.position() + distance * glm::normalize(camera.target() - camera.position());
  return {centre, static_cast<double>(kGizmoPx * camera.scene_per_px(ahead))};
}

std::optional<std::size_t> knob_at(const Camera& camera, const Gizmo& gizmo, const glm::vec2& mouse) {
  const std::array<Vec3, 3> knobs{gizmo.knob(0), gizmo.knob(1), gizmo.knob(2)};
  const auto knob = handle_at(camera, knobs, mouse);
  return knob ? std::optional<std::size_t>(*knob) : std::nullopt;
}

void drag_knob(Editor& editor, Tool tool, const Camera& camera, const Gizmo& gizmo, std::size_t axis,
               const glm::vec2& from, const glm::vec2& to) {
  const double lengths = lengths_along(camera, gizmo, axis, to - from),
               angle = turn_about(camera, gizmo, axis, to - from);
  switch (tool) {
    case Tool::kMove:
      return editor.move(along(axis, lengths * gizmo.length));
    case Tool::kScale: {
      Vec3 by{1, 1, 1};
      by[axis] = std::max(1 + lengths, kMinFactor);
      return editor.scale(by);
    }
    case Tool::kRotate:
      return editor.rotate(axis, angle);
    case Tool::kTwist:
      return editor.twist(axis, angle);
    case Tool::kBend:
      return editor.bend(bent_line(editor.box(), axis), angle);
  }
}

Markup markup_of(const Editor& editor, std::span<const Face> handle_faces, Tool tool, const Gizmo& gizmo,
                 std::optional<std::uint32_t> hovered) {
  Markup markup;
  const std::span<const Vec3> handles = editor.handles();
  for (const Face& face : handle_faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t a = face[k], b = face[(k + 1) % 3];
      if (a < b) markup.lines.push_back({glm_from(handles[a]), glm_from(handles[b]), kCage, 1.2F, false});
    }
  }
  for (std::uint32_t i = 0; i < handles.size(); ++i) {
    const float size = i == hovered ? 13.0F : editor.is_chosen(i) ? 10.0F : 7.0F;
    markup.dots.push_back({glm_from(handles[i]), editor.is_chosen(i) ? kChosen : kHandle, size, false});
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const glm::vec3 from = glm_from(gizmo.centre), to = glm_from(gizmo.knob(axis));
    markup.lines.push_back({from, to, kAxisColours[axis], 2.5F, true});
    markup.dots.push_back({to, kAxisColours[axis], tool == Tool::kMove || tool == Tool::kScale ? 13.0F : 17.0F, true});
    if (tool == Tool::kMove || tool == Tool::kScale) continue;
    // Tools that turn show an arc across their axis.
    constexpr int kPieces = 10;
    const auto on_arc = [&](int piece) {
      const double angle = (piece / static_cast<double>(kPieces) - 0.5) * std::numbers::pi / 2;
      return glm_from(gizmo.knob(axis) + along((axis + 1) % 3, 0.3 * gizmo.length * std::sin(angle)) +
                      along((axis + 2) % 3, 0.3 * gizmo.length * (std::cos(angle) - 1)));
    };
    for (int piece = 0; piece < kPieces; ++piece)
      markup.lines.push_back({on_arc(piece), on_arc(piece + 1), kAxisColours[axis], 2.0F, true});
  }
  return markup;
}

std::optional<Command> command_for_key(std::string_view key, const Modifiers& modifiers) {
  if (key == "Z" && modifiers.control && modifiers.shift) return Command::kRedo;
  const auto binding = std::find_if(kBindings.begin(), kBindings.end(),
                                    [&](const Binding& b) { return b.key == key && b.control == modifiers.control; });
  return binding == kBindings.end() ? std::nullopt : std::optional(binding->command);
}

void Hand::press(MouseButton button, const glm::vec2& mouse, const Modifiers& modifiers) {
  if (doing_ != Doing::kNothing) return;  // the button that began it ends it
  mouse_ = pressed_ = mouse;
  moved_ = false;
  button_ = button;
  if (button == MouseButton::kLeft)
    press_left(modifiers);
  else
    doing_ = Doing::kPanning;
}

void Hand::press_left(const Modifiers& modifiers) {
  const Gizmo knobs = gizmo();
  if (const auto axis = knob_at(camera_, knobs, mouse_); axis && !modifiers.shift) {
    doing_ = Doing::kKnob;
    grabbed_ = knobs;
    axis_ = *axis;
    return editor_.begin();
  }
  const auto handle = handle_at(camera_, editor_.handles(), mouse_);
  if (!handle) {
    doing_ = modifiers.shift ? Doing::kChoosing : Doing::kTurning;
    return;
  }
  if (modifiers.shift || modifiers.control) return editor_.toggle(*handle);
  if (!editor_.is_chosen(*handle)) editor_.choose(std::array{*handle}, false);
  doing_ = Doing::kHandles;
  held_ = editor_.handles()[*handle];
  editor_.begin();
}

void Hand::move(const glm::vec2& mouse) {
  const glm::vec2 step = mouse - mouse_;
  mouse_ = mouse;
  if (glm::length(mouse_ - pressed_) > kClickPx) moved_ = true;
  if (doing_ == Doing::kHandles && moved_) editor_.move(shift_in_view(camera_, held_, pressed_, mouse_));
  if (doing_ == Doing::kKnob && moved_) drag_knob(editor_, tool_, camera_, grabbed_, axis_, pressed_, mouse_);
  if (doing_ == Doing::kTurning) camera_.rotate(step);
  if (doing_ == Doing::kPanning) camera_.pan(step);
}

void Hand::release(MouseButton button) {
  if (doing_ == Doing::kNothing || button != button_) return;
  if (doing_ == Doing::kChoosing)
    editor_.choose(handles_within(camera_, editor_.handles(), pressed_, mouse_), true);
  else if (doing_ == Doing::kTurning && !moved_)
    editor_.choose_none();
  editor_.finish();
  doing_ = Doing::kNothing;
}

void Hand::wheel(float steps) {
  if (doing_ != Doing::kHandles && doing_ != Doing::kKnob) camera_.zoom(steps, mouse_);
}

bool Hand::command(Command command) {
  if (command <= Command::kBend) {
    tool_ = static_cast<Tool>(command);
  } else if (command == Command::kChooseAll) {
    std::vector<std::uint32_t> all(editor_.handles().size());
    std::iota(all.begin(), all.end(), 0U);
    editor_.choose(all, false);
  } else if (command == Command::kChooseNone && editor_.is_under_way()) {
    editor_.cancel();
    doing_ = Doing::kNothing;
  } else if (command == Command::kChooseNone) {
    editor_.choose_none();
  } else if (command == Command::kUndo) {
    editor_.undo();
  } else if (command == Command::kRedo) {
    editor_.redo();
  } else if (command == Command::kReset) {
    editor_.reset();
    if (doing_ == Doing::kHandles || doing_ == Doing::kKnob) doing_ = Doing::kNothing;
  } else if (command == Command::kHome) {
    camera_.home();
  } else {
    return false;
  }
  return true;
}

Markup Hand::markup(std::span<const Face> handle_faces) const {
  const bool free = doing_ == Doing::kNothing;
  const Gizmo knobs = gizmo();
  const bool on_knob = free && knob_at(camera_, knobs, mouse_).has_value();
  const auto hovered = free && !on_knob ? handle_at(camera_, editor_.handles(), mouse_) : std::nullopt;
  Markup markup = markup_of(editor_, handle_faces, tool_, knobs, hovered);
  if (doing_ == Doing::kChoosing) markup.frame.emplace(pressed_, mouse_);
  return markup;
}

}  // namespace eigencast::studio
