// SPDX-License-Identifier: MIT
#include "sender/studio/hand.h"

#include <algorithm>
#include <array>
#include <glm/geometric.hpp>
#include <numeric>

namespace eigencast::studio {
namespace {

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

std::optional<Command> command_for_key(std::string_view key, const Modifiers& modifiers) {
  if (key == "Z" && modifiers.control && modifiers.shift) return Command::kRedo;
  const auto binding = std::find_if(kBindings.begin(), kBindings.end(),
                                    [&](const Binding& b) { return b.key == key && b.control == modifiers.control; });
  if (binding == kBindings.end()) return std::nullopt;
  return binding->command;
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
  switch (doing_) {
    case Doing::kHandles:
      if (moved_) editor_.move(shift_in_view(camera_, held_, pressed_, mouse_));
      break;
    case Doing::kKnob:
      if (moved_) drag_knob(editor_, tool_, camera_, grabbed_, axis_, pressed_, mouse_);
      break;
    case Doing::kTurning:
      camera_.rotate(step);
      break;
    case Doing::kPanning:
      camera_.pan(step);
      break;
    case Doing::kChoosing:
    case Doing::kNothing:
      break;
  }
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
    return true;
  }
  switch (command) {
    case Command::kChooseAll: {
      std::vector<std::uint32_t> all(editor_.handles().size());
      std::iota(all.begin(), all.end(), 0U);
      editor_.choose(all, false);
      return true;
    }
    case Command::kChooseNone:
      if (editor_.is_under_way())
        editor_.cancel(), doing_ = Doing::kNothing;
      else
        editor_.choose_none();
      return true;
    case Command::kUndo:
      editor_.undo();
      return true;
    case Command::kRedo:
      editor_.redo();
      return true;
    case Command::kReset:
      editor_.reset();
      if (doing_ == Doing::kHandles || doing_ == Doing::kKnob) doing_ = Doing::kNothing;
      return true;
    case Command::kHome:
      camera_.home();
      return true;
    default:
      return false;
  }
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
