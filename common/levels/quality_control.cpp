// SPDX-License-Identifier: MIT
#include "common/levels/quality_control.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

namespace eigencast {
namespace {

constexpr double kLate = 100;   // of the largest error, for twice the time: being in time goes before all
constexpr double kRoom = 0.92;  // of the budget, for a change that costs time
constexpr double kMostSaved = 0.95;

double cost_of(std::span<const ObjectView> objects, std::uint32_t ObjectView::*count) {
  double cost = 0;
  for (const ObjectView& object : objects) cost += object.vertex_cost * object.*count;
  return cost;
}

}  // namespace

QualityControl::QualityControl(const Settings& settings)
    : settings_(settings), levels_(settings.budget), steps_(settings.knobs.size()) {
  assert(
      std::all_of(settings.knobs.begin(), settings.knobs.end(), [](const auto& knob) { return !knob.steps.empty(); }));
}

bool QualityControl::lowered() const {
  return std::any_of(steps_.begin(), steps_.end(), [](std::size_t step) { return step > 0; });
}

double QualityControl::time_left(const Steps& steps) const {
  double left = 1;
  for (std::size_t k = 0; k < steps.size(); ++k)
    left *= 1 - settings_.knobs[k].saved * settings_.knobs[k].steps[steps[k]].saved;
  return left;
}

double QualityControl::error_of(const Steps& steps, const Scene& scene, double budget_s) const {
  double error = 0, largest = settings_.vertex_error;
  for (std::size_t k = 0; k < steps.size(); ++k) {
    error += settings_.knobs[k].error * settings_.knobs[k].steps[steps[k]].error;
    largest += settings_.knobs[k].error;
  }
  const double left = time_left(steps), room = budget_s / left - levels_.fixed_s();
  const double V = std::clamp(room / levels_.slope_s(), scene.least, scene.most);
  if (V > 0) error += settings_.vertex_error * (scene.most / V - 1);
  const double late = left * (levels_.fixed_s() + levels_.slope_s() * V) / budget_s - 1;
  return error + kLate * largest * std::max(0.0, late);
}

QualityControl::Steps QualityControl::best(const Scene& scene, double budget_s) const {
  Steps tried(steps_.size()), found = tried;
  double least = error_of(tried, scene, budget_s);
  const auto next = [&] {  // counts through all combinations
    for (std::size_t k = 0; k < tried.size(); ++k) {
      if (++tried[k] < settings_.knobs[k].steps.size()) return true;
      tried[k] = 0;
    }
    return false;
  };
  while (next()) {
    const double error = error_of(tried, scene, budget_s);
    if (error < least) least = error, found = tried;
  }
  return found;
}

void QualityControl::learn(double seconds) {
  const double predicted = time_left(steps_) * (levels_.fixed_s() + levels_.slope_s() * levels_.drawn());
  if (predicted > 0) ratios_.push_back(std::clamp(seconds / predicted, 0.5, 2.0));
  if (ratios_.size() < static_cast<std::size_t>(kLearn) || !changed_) return;
  std::nth_element(ratios_.begin(), ratios_.begin() + kLearn / 2, ratios_.end());
  // What the lower of the two steps saves was wrong.
  QualityKnob& knob = settings_.knobs[*changed_];
  const double median = ratios_[kLearn / 2], left = (1 - knob.saved * changed_part_) * (rose_ ? 1 / median : median);
  if (changed_part_ > 0) knob.saved = std::clamp((1 - left) / changed_part_, 0.0, kMostSaved);
  changed_.reset();
}

void QualityControl::change_to(const Steps& steps) {
  const bool rises = time_left(steps) > time_left(steps_);
  if (rose_ && !rises && since_change_ < 3 * kWait) wait_ = std::min(2 * wait_, kLongestWait);
  double most = 0;
  changed_.reset();
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const double saved = settings_.knobs[k].saved;
    if (steps[k] == steps_[k] || saved < most) continue;
    most = saved;
    changed_ = k;
    changed_part_ = settings_.knobs[k].steps[std::max(steps[k], steps_[k])].saved;
  }
  steps_ = steps;
  rose_ = rises;
  since_change_ = 0;
  ratios_.clear();
}

void QualityControl::adapt(const Scene& scene) {
  const double budget_s = levels_.fill() / settings_.budget.f0;
  const double full_s = levels_.fixed_s() + levels_.slope_s() * scene.most;
  trial_wanted_ = settings_.trials && (full_s > budget_s || lowered()) &&
                  (next_trial_ < settings_.knobs.size() || since_trial_ >= kTrialEvery);
  if (pictures_ < kLearn || since_change_ < kLearn) return;
  if (settings_.trials && next_trial_ < settings_.knobs.size()) return;  // measured first, at full quality
  const double now = error_of(steps_, scene, budget_s);
  if (const Steps cheaper = best(scene, budget_s);
      time_left(cheaper) < time_left(steps_) && error_of(cheaper, scene, budget_s) < (1 - kBetter) * now)
    return change_to(cheaper);
  if (since_change_ < wait_) return;
  if (since_change_ % kLongestWait == 0) wait_ = std::max(kWait, wait_ / 2);
  const Steps finer = best(scene, kRoom * budget_s);
  if (time_left(finer) > time_left(steps_) && error_of(finer, scene, kRoom * budget_s) < (1 - kBetter) * now)
    change_to(finer);
}

QualityControl::Choice QualityControl::choose(std::span<const ObjectView> objects, std::optional<FrameWork> last) {
  std::vector<ObjectView> bounded(objects.begin(), objects.end());
  for (ObjectView& object : bounded)
    object.min = std::max(object.min, static_cast<std::uint32_t>(std::lround(kFewVertices * object.max)));
  const double few = cost_of(bounded, &ObjectView::min), least = cost_of(objects, &ObjectView::min);
  if (levels_.slope_s() * (few - least) >= kWorthwhile * (levels_.fixed_s() + levels_.slope_s() * few))
    bounded.assign(objects.begin(), objects.end());
  if (last && std::isfinite(last->seconds) && last->seconds > 0) {
    ++pictures_, ++since_change_, ++since_trial_;
    if (changed_) {
      learn(last->seconds);
      last.reset();  // It says what the change saves, not what the scene costs.
    }
    adapt({cost_of(bounded, &ObjectView::min), cost_of(bounded, &ObjectView::max)});
  }
  levels_.set_time_left(time_left(steps_));
  return {steps_, levels_.resolve(bounded, last)};
}

std::optional<std::size_t> QualityControl::trial() {
  if (!std::exchange(trial_wanted_, false)) return std::nullopt;
  since_trial_ = 0;
  const std::size_t knobs = settings_.knobs.size(), knob = next_trial_++ % knobs;
  if (next_trial_ >= 2 * knobs) next_trial_ = knobs;
  return steps_[knob] == 0 ? std::optional(knob) : std::nullopt;
}

void QualityControl::measured(std::size_t knob, double saved, double error) {
  assert(knob < settings_.knobs.size());
  if (!std::isfinite(saved) || !std::isfinite(error) || steps_[knob] > 0) return;
  const double before = std::exchange(settings_.knobs[knob].error, std::max(error, 0.0));
  settings_.knobs[knob].saved = std::clamp(saved, 0.0, kMostSaved);
  // Fewer vertices lose edges, as fewer pixels do.
  if (knob == 0 && before > 0) settings_.vertex_error *= settings_.knobs[0].error / before;
}

}  // namespace eigencast
