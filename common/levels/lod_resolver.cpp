// SPDX-License-Identifier: MIT
#include "common/levels/lod_resolver.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

namespace eigencast {
namespace {

bool is_usable(const std::optional<FrameWork>& work) {
  return work && std::isfinite(work->seconds) && work->seconds > 0;
}

std::uint32_t clamped(double n, const ObjectView& object) {
  return static_cast<std::uint32_t>(std::clamp(n, static_cast<double>(object.min), static_cast<double>(object.max)));
}

/// The value of that rank, from 0. REQUIRES: rank < values.size().
double ranked(std::vector<double> values, std::size_t rank) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

double PaperResolver::level(double scaled, double kappa) {
  const double g = 1 - scaled;
  const double f = kappa >= 0 ? kappa * scaled : kappa * (1 - scaled);
  return std::clamp(g + f, 0.0, 1.0);
}

void PaperResolver::adjust(const FrameWork& work) {
  if (!interval_began_us_) interval_began_us_ = work.now_us;
  interval_work_ += work.seconds;
  ++interval_frames_;
  if (work.now_us - *interval_began_us_ < settings_.interval_us) return;
  const double f = interval_frames_ / interval_work_;
  if (f > settings_.f0 + settings_.threshold) kappa_ = std::min(kappa_ + settings_.delta, 1.0);
  if (f < settings_.f0 - settings_.threshold) kappa_ = std::max(kappa_ - settings_.delta, -1.0);
  interval_began_us_ = work.now_us;
  interval_work_ = 0;
  interval_frames_ = 0;
}

std::vector<std::uint32_t> PaperResolver::resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) {
  assert(settings_.far > settings_.near);
  if (is_usable(last)) adjust(*last);
  std::vector<std::uint32_t> n;
  for (const ObjectView& object : objects) {
    const double scaled = std::clamp((object.distance - settings_.near) / (settings_.far - settings_.near), 0.0, 1.0);
    n.push_back(clamped(std::round(level(scaled, kappa_) * object.max), object));
  }
  return n;
}

std::vector<std::uint32_t> split_budget(std::span<const ObjectView> objects, double budget) {
  std::vector<double> share(objects.size());
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const ObjectView& object = objects[i];
    share[i] = object.pixels > 0 ? object.pixels * std::sqrt(object.bend / object.vertex_cost) : 0;
  }
  // cost(scale) = sum of cost x clamp(scale x share) grows and is linear between the points where an object meets a
  // bound: bisection over those points, then one linear step.
  const auto n_at = [&](std::size_t i, double scale) {
    return std::clamp(scale * share[i], static_cast<double>(objects[i].min), static_cast<double>(objects[i].max));
  };
  const auto cost_at = [&](double scale) {
    double cost = 0;
    for (std::size_t i = 0; i < objects.size(); ++i) cost += objects[i].vertex_cost * n_at(i, scale);
    return cost;
  };
  std::vector<double> turns{0};
  for (std::size_t i = 0; i < objects.size(); ++i) {
    if (share[i] <= 0) continue;
    turns.push_back(objects[i].min / share[i]);
    turns.push_back(objects[i].max / share[i]);
  }
  // They are sorted as far as the search needs.
  auto above = turns.begin();
  for (auto end = turns.end(); above != end;) {
    const auto middle = above + (end - above) / 2;
    std::nth_element(above, middle, end);
    if (cost_at(*middle) <= budget) {
      above = middle + 1;
    } else {
      end = middle;
    }
  }
  double scale = turns.back();
  if (above != turns.end()) {
    const double low = above == turns.begin() ? 0 : *std::prev(above);
    const double cost_low = cost_at(low);
    const double slope = (cost_at(*above) - cost_low) / (*above - low);
    scale = above == turns.begin() ? 0 : low + std::max(0.0, budget - cost_low) / slope;
  }
  std::vector<std::uint32_t> n;
  for (std::size_t i = 0; i < objects.size(); ++i) n.push_back(clamped(std::floor(n_at(i, scale)), objects[i]));
  return n;
}

double DriftingValue::deviation() const {
  return 1.4826 * ranked(distances_, distances_.size() / 2);  // of normal noise
}

void DriftingValue::add(double measured, double far) {
  constexpr std::size_t kFew = 4;  // give no noise
  if (!value_) value_ = measured;
  const double distance = measured - *value_, before = std::exchange(last_, measured);
  if (distances_.size() >= kFew) far = std::min(far, kFar * deviation());
  const bool is_far = std::abs(distance) > far;
  if (is_far && far_before_ * distance > 0) {
    value_ = 0.5 * (measured + before);
  } else if (!is_far) {
    *value_ += kGain * distance;
  }
  far_before_ = is_far ? distance : 0;
  distances_.push_back(std::abs(distance));
  if (distances_.size() > kWindow) distances_.erase(distances_.begin());
}

void PlanMargin::add(double ratio) {
  ratios_.push_back(ratio);
  if (ratios_.size() > kWindow) ratios_.erase(ratios_.begin());
}

double PlanMargin::fill() const {
  double late = 1.05;
  if (ratios_.size() >= kMinFrames) late = ranked(ratios_, ratios_.size() * 19 / 20);
  return std::clamp(kEdge * deadline_ / late, kMin, 1.0);
}

BudgetResolver::BudgetResolver(const Settings& settings)
    : settings_(settings), slope_(settings.start_cost), margin_(settings.deadline) {}

void BudgetResolver::learn(double seconds) {
  constexpr std::size_t kFirst = 8;  // predict nothing
  if (samples_.size() >= kFirst) margin_.add(seconds / (fixed_ + slope_ * drawn_));
  samples_.push_back({drawn_, seconds});
  if (samples_.size() > kWindow) samples_.erase(samples_.begin());

  double mean_v = 0, mean_t = 0;
  for (const Sample& s : samples_) mean_v += s.vertices, mean_t += s.seconds;
  mean_v /= static_cast<double>(samples_.size());
  mean_t /= static_cast<double>(samples_.size());
  double variance = 0, covariance = 0;
  for (const Sample& s : samples_) {
    variance += (s.vertices - mean_v) * (s.vertices - mean_v);
    covariance += (s.vertices - mean_v) * (s.seconds - mean_t);
  }
  // The old slope weighs as much as a variation of V by a tenth, so that it is stable while V is constant.
  const double prior = 0.01 * mean_v * mean_v * static_cast<double>(samples_.size());
  if (variance + prior > 0) slope_ = (covariance + prior * slope_) / (variance + prior);
  // The vertices take between 2 % and all of a frame's time. The median of three: one frame that the system delayed (a
  // page fault, another program) must not move the level.
  std::vector<double> newest;
  for (auto s = samples_.rbegin(); s != samples_.rend() && newest.size() < 3; ++s) newest.push_back(s->seconds);
  const double per_vertex = ranked(newest, newest.size() / 2) / std::max(drawn_, 1.0);
  slope_ = std::clamp(slope_, 0.02 * per_vertex, per_vertex);
  rest_.add(seconds - slope_ * drawn_, 0.25 * seconds);
  fixed_ = std::max(0.0, rest_.value());
}

void BudgetResolver::judge(double min_cost, double seconds) {
  const double frame = frame_s();
  const bool at_min = drawn_ <= min_cost * (1 + kDeadBand);
  const bool hopeless = at_min && seconds > frame && fixed_ > frame;
  const bool hopeful = fixed_ + slope_ * min_cost < margin_.fill() * frame;
  frames_against_ = (within_reach_ ? hopeless : hopeful) ? frames_against_ + 1 : 0;
  if (frames_against_ < kPatience) return;
  within_reach_ = !within_reach_;
  frames_against_ = 0;
}

double BudgetResolver::wanted_vertices(double min_cost, double max_cost) const {
  const double planned = within_reach_ ? margin_.fill() * frame_s() : (1 + kShare) * (fixed_ + slope_ * min_cost);
  double wanted = std::clamp((planned - fixed_) / slope_, 0.0, max_cost);
  if (drawn_ <= 0) return wanted;
  // The part of the vertices that is in time if they took all of the last frame's time.
  const double part = samples_.empty() ? 1 : margin_.fill() * frame_s() / samples_.back().seconds;
  wanted = std::clamp(wanted, drawn_ * std::min(kFall, part), drawn_ * kGrowth);
  const bool small = std::abs(wanted - drawn_) < kDeadBand * drawn_ && wanted < max_cost;
  return small ? drawn_ : wanted;
}

std::vector<std::uint32_t> BudgetResolver::resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) {
  double min_cost = 0, max_cost = 0, drawn = 0;
  for (const ObjectView& object : objects) {
    min_cost += object.vertex_cost * object.min;
    max_cost += object.vertex_cost * object.max;
    drawn += object.vertex_cost * object.drawn;
  }
  if (drawn > 0 && drawn_ > 0) drawn_ = drawn;
  if (is_usable(last) && drawn_ > 0) {
    learn(last->seconds / time_left_);
    judge(min_cost, last->seconds / time_left_);
  }
  auto n = split_budget(objects, wanted_vertices(min_cost, max_cost));
  drawn_ = 0;
  for (std::size_t i = 0; i < n.size(); ++i) drawn_ += objects[i].vertex_cost * n[i];
  planned_ = (fixed_ + slope_ * drawn_) / frame_s();
  return n;
}

}  // namespace eigencast
