// SPDX-License-Identifier: MIT
#include "sender/studio/editor.h"

#include <algorithm>
#include <cassert>
#include <utility>

namespace eigencast::studio {

Editor::Editor(std::vector<Vec3> rest) : rest_(std::move(rest)), handles_(rest_), chosen_(rest_.size(), 0) {}

std::size_t Editor::chosen_count() const {
  return static_cast<std::size_t>(std::count(chosen_.begin(), chosen_.end(), 1));
}

Box Editor::box() const {
  const std::vector<Vec3>& from = under_way_ ? before_ : handles_;
  const bool all = chosen_count() == 0;
  std::vector<Vec3> edited;
  for (std::size_t i = 0; i < from.size(); ++i) {
    if (all || is_chosen(i)) edited.push_back(from[i]);
  }
  return bounding_box(edited);
}

Vec3 Editor::centre() const {
  const Box b = box();
  return 0.5 * (b.low + b.high);
}

void Editor::choose(std::span<const std::uint32_t> handles, bool add) {
  if (!add) choose_none();
  for (const std::uint32_t handle : handles) chosen_[handle] = 1;
}

void Editor::begin() {
  before_ = handles_;
  under_way_ = true;
}

void Editor::transform(const std::function<Vec3(const Vec3&)>& by) {
  assert(under_way_);
  const bool all = chosen_count() == 0;
  for (std::size_t i = 0; i < handles_.size(); ++i) handles_[i] = all || is_chosen(i) ? by(before_[i]) : before_[i];
}

void Editor::finish() {
  if (!under_way_) return;
  under_way_ = false;
  remember(std::move(before_));
}

void Editor::cancel() {
  if (!under_way_) return;
  under_way_ = false;
  handles_ = std::move(before_);
}

void Editor::remember(std::vector<Vec3> before) {
  if (before == handles_) return;
  undo_.push_back(std::move(before));
  if (undo_.size() > kMaxSteps) undo_.erase(undo_.begin());
  redo_.clear();
}

bool Editor::step(std::vector<std::vector<Vec3>>& from, std::vector<std::vector<Vec3>>& to) {
  if (under_way_ || from.empty()) return false;
  to.push_back(std::exchange(handles_, std::move(from.back())));
  from.pop_back();
  return true;
}

void Editor::reset() {
  cancel();
  remember(std::exchange(handles_, rest_));
}

}  // namespace eigencast::studio
