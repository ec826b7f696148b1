// SPDX-License-Identifier: MIT
#include "common/levels/lod_resolver.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>
#include <numeric>
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

double mean_of(std::span<const double> values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
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

std::vector<LevelGain> gains_from_errors(std::span<const LevelError> errors, std::uint32_t most) {
  struct Run {
    double from, to, lost;  ///< Rows, and the error between them.
    double gain() const { return lost / (to - from); }
  };
  std::vector<Run> runs;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const bool is_last = i + 1 == errors.size();
    const double from = errors[i].rows, to = is_last ? most : errors[i + 1].rows;
    if (!(to > from)) continue;
    runs.push_back({from, to, errors[i].error - (is_last ? 0 : errors[i + 1].error)});
    while (runs.size() > 1 && runs[runs.size() - 2].gain() <= runs.back().gain()) {
      const Run last = runs.back();
      runs.pop_back();
      runs.back().to = last.to;
      runs.back().lost += last.lost;
    }
  }
  std::vector<LevelGain> gains;
  for (const Run& run : runs) {
    if (run.gain() > 0) gains.push_back({std::sqrt(std::max(run.from, 1.0) * run.to), run.gain()});
  }
  return gains;
}

namespace {

/// The rows at which one more takes `gain`. Rows are linear in its root's reciprocal, as where it is a power of -2.
double rows_with(std::span<const LevelGain> gains, double gain) {
  const double root = 1 / std::sqrt(gain);
  if (gains.empty()) return root;
  const auto above = std::find_if(gains.begin(), gains.end(), [&](const LevelGain& at) { return at.gain < gain; });
  const LevelGain& below = above == gains.begin() ? gains.front() : *std::prev(above);
  const double low = 1 / std::sqrt(below.gain);
  if (above == gains.begin() || above == gains.end()) return below.rows * root / low;
  return below.rows + (above->rows - below.rows) * (root - low) / (1 / std::sqrt(above->gain) - low);
}

}  // namespace

std::vector<std::uint32_t> split_budget(std::span<const ObjectView> objects, double budget) {
  // price: what time for a vertex has to take from the error. Cost falls as it grows: bisection by geometric means.
  const auto n_at = [&](const ObjectView& object, double price) {
    if (object.pixels <= 0) return static_cast<double>(object.min);
    const double rows = rows_with(object.gains, price * object.vertex_cost / (object.pixels * object.pixels));
    return std::clamp(rows, static_cast<double>(object.min), static_cast<double>(object.max));
  };
  const auto cost_at = [&](double price) {
    double cost = 0;
    for (const ObjectView& object : objects) cost += object.vertex_cost * n_at(object, price);
    return cost;
  };
  double low = 1e-20, high = 1e20;
  while (low > 1e-200 && cost_at(low) <= budget) high = low, low *= low;  // Where all are at their most it ends there.
  while (high < 1e200 && cost_at(high) > budget) low = high, high *= high;
  for (int i = 0; i < 60 && high > (1 + 1e-9) * low; ++i) {
    const double middle = std::sqrt(low) * std::sqrt(high);
    (cost_at(middle) <= budget ? high : low) = middle;
  }
  std::vector<std::uint32_t> n;
  for (const ObjectView& object : objects) n.push_back(clamped(std::floor(n_at(object, high)), object));
  return n;
}

double DriftingValue::noise() const {
  if (differences_.size() < kFew) return 0;
  constexpr double kOfOne = 1.4826 / std::numbers::sqrt2;  // of normal noise, by differences of two
  return kOfOne * ranked(differences_, differences_.size() / 2);
}

bool DriftingValue::add(double measured) {
  if (!seen_.empty()) {
    differences_.push_back(std::abs(measured - last_));
    if (differences_.size() > kWindow) differences_.erase(differences_.begin());
  }
  last_ = measured;
  const double far = differences_.size() < kFew ? kUsualFar * std::abs(value_) : kFar * noise();
  const double distance = measured - value_;
  if (seen_.size() >= kJump && std::abs(distance) > far) {
    if (!far_.empty() && (far_.front() > value_) != (distance > 0)) far_.clear();
    far_.push_back(measured);
    if (far_.size() < kJump) return false;
    seen_ = std::exchange(far_, {});
    value_ = mean_of(seen_);
    return true;
  }
  far_.clear();
  seen_.push_back(measured);
  if (seen_.size() > kMean) seen_.erase(seen_.begin());
  forget_drifted();
  value_ = seen_.size() < kFew ? ranked(seen_, seen_.size() / 2) : mean_of(seen_);
  return false;
}

void DriftingValue::forget_drifted() {
  if (seen_.size() < 2 * kFew) return;
  const auto newest = std::span(seen_).last(kFew), before = std::span(seen_).first(seen_.size() - kFew);
  const double of_means = noise() * std::sqrt(1.0 / kFew + 1.0 / static_cast<double>(before.size()));
  if (std::abs(mean_of(newest) - mean_of(before)) > kDrift * of_means) seen_.erase(seen_.begin(), seen_.end() - kFew);
}

void DriftingValue::scale(double factor) {
  for (std::vector<double>* values : {&seen_, &far_, &differences_}) {
    for (double& value : *values) value *= factor;
  }
  value_ *= factor;
  last_ *= factor;
}

void PlanMargin::add(double ratio) {
  ratios_.push_back(ratio);
  if (ratios_.size() > kWindow) ratios_.erase(ratios_.begin());
  fill_ += std::clamp(wanted() - fill_, -kFall, kRise);
}

double PlanMargin::wanted() const {
  if (ratios_.size() < kMinFrames) return fill_;
  const double late = ranked(ratios_, ratios_.size() * 19 / 20), early = ranked(ratios_, ratios_.size() / 20);
  return std::min(std::max(kEdge * deadline_ / late, used_ / early), 1.0);
}

BudgetResolver::BudgetResolver(const Settings& settings)
    : settings_(settings), slope_(settings.start_cost), margin_(settings.deadline, settings.used) {}

void BudgetResolver::learn(double seconds, double max_cost) {
  constexpr int kFirst = 8;  // predict nothing
  if (learned_ >= kFirst) margin_.add(seconds / (fixed_ + slope_ * drawn_));
  // One picture that the system delayed (a page fault, another program) says little of what vertices take.
  newest_.push_back(seconds);
  if (newest_.size() > 3) newest_.erase(newest_.begin());
  const double per_vertex = ranked(newest_, newest_.size() / 2) / std::max(drawn_, 1.0);
  if (learned_++ == 0) mean_v_ = drawn_, mean_t_ = seconds, slope_ = kFirstShare * per_vertex;
  const double dv = drawn_ - mean_v_, dt = std::clamp(seconds - mean_t_, -0.5 * mean_t_, 0.5 * mean_t_);
  const bool is_far = std::abs(seconds - slope_ * drawn_ - fixed_) > DriftingValue::kFar * rest_.noise();
  // What is far off is another change, once the model holds.
  if (std::abs(dv) > kLittle * mean_v_ && (!is_far || learned_ <= kFirst)) {
    const double least = kKnown * std::max(slope_, 0.2 * mean_t_ / max_cost);
    weight_ = std::min(weight_, std::max(rest_.noise() / least, 1e-9));
    const double gain = dv * dv / (weight_ * weight_ + dv * dv);
    slope_ += gain * (std::clamp(dt / dv, 0.0, per_vertex) - slope_);
    weight_ = std::sqrt(weight_ * weight_ + dv * dv);
  }
  mean_v_ += kGain * (drawn_ - mean_v_);
  mean_t_ += kGain * dt;
  slope_ = std::clamp(slope_, std::min(0.02 * mean_t_ / max_cost, per_vertex), per_vertex);
  if (rest_.add(seconds - slope_ * drawn_)) mean_v_ = drawn_, mean_t_ = seconds;
  fixed_ = std::max(0.0, rest_.value());
}

void BudgetResolver::scale_costs(double factor) {
  slope_ *= factor, fixed_ *= factor, mean_t_ *= factor;
  growth_ = kGrowth * std::max(1.0, 1 / factor);
  rest_.scale(factor);
  for (double& seconds : newest_) seconds *= factor;
}

void BudgetResolver::judge(double min_cost, double seconds) {
  const double frame = frame_s();
  const bool at_min = drawn_ <= 1.03 * min_cost;
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
  // Where the time is used nothing changes, but for the last vertices.
  const double now = fixed_ + slope_ * drawn_;
  if (now < (1 + kOver) * planned && now > (1 - kUnder) * planned && wanted < max_cost)
    return drawn_ == resolved_ ? wanted_ : drawn_;
  // The part of the vertices that is in time if they took all of the last frame's time.
  const double part = newest_.empty() ? 1 : margin_.fill() * frame_s() / newest_.back();
  return std::clamp(wanted, drawn_ * std::min(part, kLeastFall), drawn_ * growth_);
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
    learn(last->seconds, max_cost);
    judge(min_cost, last->seconds);
  }
  wanted_ = wanted_vertices(min_cost, max_cost);
  growth_ = kGrowth;
  auto n = split_budget(objects, wanted_);
  drawn_ = 0;
  for (std::size_t i = 0; i < n.size(); ++i) drawn_ += objects[i].vertex_cost * n[i];
  resolved_ = drawn_;
  planned_ = (fixed_ + slope_ * drawn_) / frame_s();
  return n;
}

}  // namespace eigencast
