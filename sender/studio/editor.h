// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "common/core/text.h"
#include "common/surface/surface.h"
#include "common/surface/vector.h"
#include "sender/deform/moves.h"

namespace eigencast::studio {

/// What dragging does to the chosen handles.
enum class Tool { kMove, kRotate, kScale, kTwist, kBend };
inline constexpr EnumNames<Tool, 5> kToolNames{{"move", "rotate", "scale", "twist", "bend"}};

/// Without a choice edits apply to all. From begin() to finish() or cancel() each edit starts from the positions at
/// begin(), and all of them are one step of undo. Pure state. Not thread-safe.
class Editor {
 public:
  static constexpr std::size_t kMaxSteps = 500;  ///< For undo.

  explicit Editor(std::vector<Vec3> rest);

  std::span<const Vec3> handles() const { return handles_; }
  std::span<const Vec3> rest() const { return rest_; }
  bool is_chosen(std::size_t handle) const { return chosen_[handle] != 0; }
  std::size_t chosen_count() const;
  /// During a gesture as of begin().
  Box box() const;
  Vec3 centre() const;

  void choose(std::span<const std::uint32_t> handles, bool add);
  void toggle(std::uint32_t handle) { chosen_[handle] = chosen_[handle] == 0; }
  void choose_none() { chosen_.assign(chosen_.size(), 0); }

  void begin();
  bool is_under_way() const { return under_way_; }
  // Each REQUIRES: is_under_way(). Angles in radians about the axis through centre(); twist and bend act over box().
  void move(const Vec3& by) {
    transform([&](const Vec3& p) { return p + by; });
  }
  void rotate(std::size_t axis, double angle) {
    transform([&, c = centre()](const Vec3& p) { return deform::turned(p, c, axis, angle); });
  }
  void scale(const Vec3& by) {
    transform([&, c = centre()](const Vec3& p) { return deform::scaled(p, c, by); });
  }
  void twist(std::size_t axis, double angle) {
    transform([&, b = box()](const Vec3& p) { return deform::twisted(p, b, {axis, (axis + 1) % 3}, angle); });
  }
  void bend(const deform::Frame& frame, double angle) {
    transform([&, b = box()](const Vec3& p) { return deform::bent(p, b, frame, angle); });
  }
  void finish();
  void cancel();

  bool undo() { return step(undo_, redo_); }
  bool redo() { return step(redo_, undo_); }
  /// Undone as one step.
  void reset();

 private:
  void transform(const std::function<Vec3(const Vec3&)>& by);
  void remember(std::vector<Vec3> before);
  bool step(std::vector<std::vector<Vec3>>& from, std::vector<std::vector<Vec3>>& to);

  std::vector<Vec3> rest_, handles_, before_;
  std::vector<char> chosen_;
  bool under_way_ = false;
  std::vector<std::vector<Vec3>> undo_, redo_;
};

}  // namespace eigencast::studio
