// SPDX-License-Identifier: MIT
#include "common/levels/quality_control.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

namespace eigencast {
namespace {

constexpr double kLate = 100;                 // of the largest error, for twice the time: being in time goes before all
constexpr double kRoom = 0.92, kFull = 0.96;  // of the budget, for a change that costs time, or that saves it
constexpr double kMostSaved = 0.95;
constexpr double kSurprise = 1.5;  // of a change's time, at most, for what it was said to take
constexpr double kStep = 0.5;      // of the rest of a picture
constexpr int kWarm = 2;           // pictures that make programs and buffers

double cost_of(std::span<const ObjectView> objects, std::uint32_t ObjectView::*count) {
  double cost = 0;
  for (const ObjectView& object : objects) cost += object.vertex_cost * object.*count;
  return cost;
}

}  // namespace

QualityKnob resolution_knob(double error, double saved) {
  QualityKnob knob{error, saved, {}};
  for (const double side : kResolutions) knob.steps.push_back({1 / side - 1, (1 - side * side) / 0.75});
  return knob;
}

std::optional<VertexProbe::Found> VertexProbe::add(double vertices, double seconds) {
  pictures_->push_back({vertices, seconds});
  if (pictures_->size() < 3 * kPictures) return std::nullopt;
  // Least squares, seconds = a + b vertices + c turn: the turn stands for what grows or falls beside.
  const double count = static_cast<double>(pictures_->size());
  double v = 0, s = 0;
  for (const Picture& picture : *pictures_) v += picture.vertices / count, s += picture.seconds / count;
  double vv = 0, tt = 0, vt = 0, vs = 0, ts = 0, ss = 0, turn = -(count - 1) / 2;
  for (const Picture& picture : *pictures_) {
    const double dv = picture.vertices - v, ds = picture.seconds - s;
    vv += dv * dv, tt += turn * turn, vt += dv * turn, vs += dv * ds, ts += turn * ds, ss += ds * ds, ++turn;
  }
  const double own = vv - vt * vt / tt;  // what the turn does not explain of the vertices
  if (own <= 1e-6 * v * v) return Found{0, s};
  const double b = (vs - vt * ts / tt) / own, c = (ts - b * vt) / tt;
  const double noise = std::max(ss - b * vs - c * ts, 0.0) / (count - 3);
  return Found{std::max(b - kSure * std::sqrt(noise / own), 0.0), s - b * (v - pictures_->front().vertices)};
}

QualityControl::QualityControl(const Settings& settings)
    : settings_(settings), f0_(settings.budget.f0), levels_(settings.budget), steps_(settings.knobs.size()) {
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

double QualityControl::fixed_s() const {
  return rests_.empty() ? levels_.fixed_s() : time_left(steps_) * median_rest_;
}

double QualityControl::error_of(const Steps& steps, const Scene& scene, double budget_s) const {
  double error = 0, largest = settings_.vertex_error;
  for (std::size_t k = 0; k < steps.size(); ++k) {
    error += settings_.knobs[k].error * settings_.knobs[k].steps[steps[k]].error;
    largest += settings_.knobs[k].error;
  }
  const double left = time_left(steps) / time_left(steps_), room = budget_s / left - fixed_s();
  const double V = std::clamp(room / levels_.slope_s(), scene.least, scene.most);
  if (V > 0) error += settings_.vertex_error * (scene.most / V - 1);
  const double late = left * (fixed_s() + levels_.slope_s() * V) / budget_s - 1;
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

void QualityControl::note_rest(double seconds) {
  rests_.push_back(std::max(seconds - levels_.slope_s() * levels_.drawn(), 0.0) / time_left(steps_));
  if (rests_.size() > kSteady) rests_.erase(rests_.begin());
  // Pictures before a step of the load would outvote those after it for half of kSteady. No gait swings as far.
  const auto steps = [this](double rest) { return std::abs(rest - median_rest_) > kStep * median_rest_; };
  if (rests_.size() > kLearn && std::all_of(rests_.end() - kLearn, rests_.end(), steps))
    rests_.erase(rests_.begin(), rests_.end() - kLearn);
  std::vector<double> sorted = rests_;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  median_rest_ = *middle;
}

void QualityControl::learn(double seconds) {
  const double predicted = levels_.fixed_s() + levels_.slope_s() * levels_.drawn();
  if (predicted > 0) ratios_.push_back(std::clamp(seconds / predicted, 1 / kSurprise, kSurprise));
  if (ratios_.size() < static_cast<std::size_t>(kLearn)) return;
  std::nth_element(ratios_.begin(), ratios_.begin() + kLearn / 2, ratios_.end());
  // What the lower of the two steps saves was wrong.
  QualityKnob& knob = settings_.knobs[*changed_];
  const double median = ratios_[kLearn / 2], left = (1 - knob.saved * changed_part_) * (rose_ ? 1 / median : median);
  if (changed_part_ > 0) knob.saved = std::clamp((1 - left) / changed_part_, 0.0, kMostSaved);
  changed_.reset();
  levels_.scale_costs(median);
}

void QualityControl::change_to(const Steps& steps) {
  const bool rises = time_left(steps) > time_left(steps_);
  if (rose_ && !rises && since_change_ < 3 * kWait) wait_ = std::min(2 * wait_, kLongestWait);
  double most = 0;
  changed_.reset();
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const double saved = settings_.knobs[k].saved;
    if (settings_.trials || steps[k] == steps_[k] || saved < most) continue;
    most = saved;
    changed_ = k;
    changed_part_ = settings_.knobs[k].steps[std::max(steps[k], steps_[k])].saved;
  }
  levels_.scale_costs(time_left(steps) / time_left(steps_));
  steps_ = steps;
  rose_ = rises;
  since_change_ = late_ = 0;
  ratios_.clear();
}

void QualityControl::follow_rate(const Scene& scene) {
  if (settings_.least_f0 <= 0) return;
  const double wanted = settings_.budget.f0;
  const double whole = wanted * (fixed_s() + levels_.slope_s() * scene.most) / time_left(steps_);
  const bool is_whole = f0_ == wanted;
  against_f0_ = is_whole ? (whole > 2 ? against_f0_ + 1 : 0) : (whole < 1 ? against_f0_ + 1 : 0);
  if (against_f0_ < (is_whole ? kLearn : kWait)) return;
  f0_ = is_whole ? std::min(settings_.least_f0, wanted) : wanted;
  levels_.set_f0(f0_);
  against_f0_ = 0;
}

void QualityControl::adapt(const Scene& scene) {
  follow_rate(scene);
  const double budget_s = levels_.fill() / f0_;
  const double full_s = fixed_s() + levels_.slope_s() * scene.most;
  trial_wanted_ = settings_.trials && (full_s > budget_s || lowered()) &&
                  (measures() || since_trial_ >= kTrialEvery);
  if (pictures_ < kWarm + kLearn || since_change_ < kLearn) return;
  if (measures()) return;  // at full quality
  const double now = error_of(steps_, scene, budget_s);
  const Steps cheaper = best(scene, kFull * budget_s);
  const bool helps = time_left(cheaper) < time_left(steps_) && error_of(cheaper, scene, budget_s) < (1 - kBetter) * now;
  late_ = helps ? late_ + 1 : 0;
  if (late_ >= kLearn) return change_to(cheaper);
  if (since_change_ < wait_) return;
  if (since_change_ % kLongestWait == 0) wait_ = std::max(kWait, wait_ / 2);
  // Time that nothing uses, beside all vertices, is used for any less error, and takes none of them.
  const double room_s = kRoom * budget_s;
  const bool idle = full_s < room_s;
  const Scene asked{idle ? scene.most : scene.least, scene.most};
  const Steps finer = best(asked, room_s);
  if (time_left(finer) > time_left(steps_) && error_of(finer, asked, room_s) < (idle ? 1 : 1 - kBetter) * now)
    change_to(finer);
}

void QualityControl::raise_least(std::vector<ObjectView>& objects) {
  std::vector<ObjectView> raised = objects;
  const auto in_sight =
      std::count_if(raised.begin(), raised.end(), [](const ObjectView& object) { return object.pixels > 0; });
  for (ObjectView& object : raised) {
    if (object.pixels <= 0) continue;
    const double few = std::max(kFewVertices * object.max + 0.5, kFreeVertices / static_cast<double>(in_sight));
    object.min = std::max(object.min, std::min(object.max, static_cast<std::uint32_t>(few)));
  }
  const double few = cost_of(raised, &ObjectView::min), fewer = few - cost_of(objects, &ObjectView::min);
  const double slope = levels_.slope_s(), few_s = fixed_s() + slope * few, left = time_left(steps_);
  const double sure_s = std::min(slope, left * vertex_s_) * fewer;
  if (!probe_.runs() && sure_s > 0 && sure_s >= kWorthwhile * std::max(few_s, left * few_s_)) return;
  const bool late = fixed_s() + slope * cost_of(objects, &ObjectView::max) > levels_.fill() / f0_;
  const bool knows = pictures_ > kWarm + kLearn && !measures();
  if (!probe_.runs() && late && knows && !changed_ && since_probe_ >= probe_wait_ &&
      slope * fewer >= 2 * kWorthwhile * few_s && levels_.drawn() < 1.5 * few)
    probe_.start();
  objects = std::move(raised);
  if (!probe_.doubles()) return;
  for (ObjectView& object : objects) {
    if (object.pixels > 0) object.min = std::min(object.max, 2 * object.min);
  }
}

void QualityControl::note_probe(double seconds) {
  if (!probe_.runs()) return;
  const auto found = probe_.add(levels_.drawn(), seconds);
  if (!found) return;
  probe_.stop();
  vertex_s_ = found->vertex_s / time_left(steps_);
  few_s_ = found->few_s / time_left(steps_);
  since_probe_ = 0;
  probe_wait_ = std::clamp(2 * probe_wait_, kWait, kLongestProbeWait);
}

QualityControl::Choice QualityControl::choose(std::span<const ObjectView> objects, std::optional<FrameWork> last) {
  std::vector<ObjectView> bounded(objects.begin(), objects.end());
  raise_least(bounded);
  if (last && std::isfinite(last->seconds) && last->seconds > 0) {
    ++pictures_, ++since_change_, ++since_trial_, ++since_probe_;
    if (pictures_ > kWarm && levels_.drawn() > 0) note_rest(last->seconds);
    const double left = time_left(steps_);
    note_probe(last->seconds);
    if (changed_) {
      learn(last->seconds);
      last.reset();  // It says what the change saves, not what the scene costs.
    } else if (pictures_ <= kWarm) {
      last.reset();
    }
    if (pictures_ > kWarm && !probe_.runs())
      adapt({cost_of(bounded, &ObjectView::min), cost_of(bounded, &ObjectView::max)});
    if (last) last->seconds *= time_left(steps_) / left;
  }
  return {steps_, levels_.resolve(bounded, last)};
}

std::optional<std::size_t> QualityControl::trial() {
  if (!std::exchange(trial_wanted_, false)) return std::nullopt;
  since_trial_ = 0;
  const std::size_t knobs = settings_.knobs.size(), knob = next_trial_++ % knobs;
  if (next_trial_ >= 2 * knobs) next_trial_ = knobs;
  return knob;
}

void QualityControl::measured(std::size_t knob, double own, double other, double error) {
  assert(knob < settings_.knobs.size());
  const double saved = steps_[knob] > 0 ? 1 - own / other : 1 - other / own;
  if (!std::isfinite(saved) || !std::isfinite(error)) return;
  QualityKnob& of = settings_.knobs[knob];
  const QualityKnob::Step step = steps_[knob] > 0 ? of.steps[steps_[knob]] : QualityKnob::Step{1, 1};
  if (step.saved <= 0 || step.error <= 0) return;
  const double before = std::exchange(of.error, std::max(error / step.error, 0.0));
  of.saved = std::clamp(saved / step.saved, 0.0, kMostSaved);
  // Fewer vertices lose edges, as fewer pixels do.
  if (knob == 0 && before > 0) settings_.vertex_error *= of.error / before;
}

}  // namespace eigencast
