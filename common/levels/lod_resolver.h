// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

struct ObjectView {
  std::uint32_t max = 0;    ///< Largest level that can be drawn now, vertices.
  std::uint32_t min = 0;    ///< Smallest level that may be drawn; <= max.
  double distance = 0;      ///< From the eye to the barycentre of the pose; scene units, >= 0.
  double pixels = 0;        ///< Diameter on the screen; 0 if out of sight.
  double vertex_cost = 1;   ///< Relative cost of a vertex; > 0.
  std::uint32_t drawn = 0;  ///< In the last frame, which may lag behind the resolved level; 0: as resolved.
  /// Geometric error of its levels times their vertices, over its diameter, in the unit of all objects; > 0.
  double bend = 1;
};

/// The time to make a frame, without waiting for the display.
struct FrameWork {
  TimeUs now_us = 0;   ///< End of the work.
  double seconds = 0;  ///< Ignored if it is not finite or not positive.
};

/// Chooses how many vertices of each surface to draw in the next frame. Not thread-safe.
class LodResolver {
 public:
  virtual ~LodResolver() = default;

  /// last: nothing before the first frame. Returns N for each object, min <= N <= max.
  virtual std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) = 0;

  /// For plots: kappa of the paper, or the planned part of a frame's time.
  virtual double state() const = 0;
};

/// Eq. 5, Eq. 6 and Algorithm 1 of Zhang, Dou, Zhou, Wu 2013, "Streaming 3D deforming surfaces with dynamic resolution
/// control":
///
///   L_i = G(d_i) + F(f, d_i),  G = 1 - d',  F = kappa d' (kappa >= 0) or kappa (1 - d') (kappa < 0)
///
/// d' is the distance scaled to [0, 1] between `near` and `far`; kappa is one for all objects and moves by delta in
/// each interval in which the frame rate f leaves f0 +- T_f. The paper leaves the interval open: 100 ms here. L = 0
/// draws nothing there; here an object keeps its min.
class PaperResolver final : public LodResolver {
 public:
  struct Settings {
    double f0 = 20;                ///< Wanted frames per second.
    double threshold = 3;          ///< T_f, frames per second.
    double delta = 0.01;           ///< Step of kappa per interval.
    TimeUs interval_us = 100'000;  ///< (default: 100 ms)
    double near = 0;               ///< Distance at which d' = 0.
    double far = 1;                ///< Distance at which d' = 1; > near.
  };

  explicit PaperResolver(const Settings& settings) : settings_(settings) {}

  std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) override;
  double state() const override { return kappa_; }

  /// Clamped to [0, 1]. `scaled` is d'.
  static double level(double scaled, double kappa);

 private:
  void adjust(const FrameWork& work);

  Settings settings_;
  double kappa_ = 0;
  std::optional<TimeUs> interval_began_us_;
  double interval_work_ = 0;  ///< Seconds of work of the frames of this interval.
  int interval_frames_ = 0;
};

/// Follows noisy measurements. Ignores an outlier; a second one in a row on the same side is a jump of the value.
class DriftingValue {
 public:
  static constexpr double kGain = 0.3;        ///< For measurements within the noise.
  static constexpr double kFar = 3;           ///< Standard deviations.
  static constexpr std::size_t kWindow = 16;  ///< Measurements that give the noise.

  /// far: upper bound of the distance that is not an outlier.
  void add(double measured, double far);
  double value() const { return value_.value_or(0); }

 private:
  double deviation() const;

  std::optional<double> value_;
  double last_ = 0;
  double far_before_ = 0;          ///< Distance of the last one, if an outlier.
  std::vector<double> distances_;  ///< Between measurements and value.
};

/// The part of a frame's time to plan for, so that 19 of 20 frames meet the deadline.
class PlanMargin {
 public:
  static constexpr std::size_t kWindow = 64;     ///< Frames.
  static constexpr std::size_t kMinFrames = 16;  ///< Fewer give no statistics.
  static constexpr double kMin = 0.85;           ///< Lower bound of fill().
  static constexpr double kEdge = 0.97;          ///< Upper bound, of the deadline.

  explicit PlanMargin(double deadline) : deadline_(deadline) {}
  /// ratio: the time of a frame over its prediction; > 0.
  void add(double ratio);
  double fill() const;

 private:
  double deadline_;
  std::vector<double> ratios_;
};

/// Keeps each frame's work within its time, and spends that time where it is seen.
///
/// The model of a frame's cost is a + b V, where V sums cost x N over the objects. b comes from least squares over the
/// last frames, limited by how much V has varied; a is a DriftingValue, so that a step of the load is answered within a
/// few frames and noise is not. V follows from the budget. It is split so that the sum of the errors on the screen is
/// least: linear interpolation between vertices is off by the square of an edge, bend pixels^2 / N in all, hence
/// N ~ pixels sqrt(bend / cost) within its bounds.
///
/// If a alone exceeds a frame's time for kPatience frames at the smallest V, no V holds the rate: then the vertices may
/// take kShare of the time at the smallest V, until the model says as long that the smallest V would be in time again.
///
/// V grows by at most kGrowth a frame, and shrinks no faster than the late frame demands, or by kFall.
class BudgetResolver final : public LodResolver {
 public:
  static constexpr double kGrowth = 1.15;
  static constexpr double kFall = 0.6;
  static constexpr double kDeadBand = 0.03;
  static constexpr std::size_t kWindow = 48;  ///< Frames of the fit.
  static constexpr double kShare = 0.25;      ///< See above.
  static constexpr int kPatience = 8;         ///< Frames.

  struct Settings {
    double f0 = 60;            ///< Wanted frames per second.
    double deadline = 1;       ///< In times of 1 / f0: see PlanMargin.
    double start_cost = 1e-7;  ///< Seconds per vertex, before the first measurement.
  };

  explicit BudgetResolver(const Settings& settings);

  std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) override;
  /// The planned work of the last frame, as a part of 1 / f0.
  double state() const override { return planned_; }

  /// The part of its time that a picture takes from now on (default: 1). Seconds given, and the budget, are divided by
  /// it.
  void set_time_left(double part) { time_left_ = part; }
  double fixed_s() const { return fixed_; }       ///< a
  double slope_s() const { return slope_; }       ///< b
  double drawn() const { return drawn_; }         ///< V of the last frame.
  double fill() const { return margin_.fill(); }  ///< The part of 1 / f0 to plan for.

 private:
  struct Sample {
    double vertices;
    double seconds;
  };
  void learn(double seconds);
  void judge(double min_cost, double seconds);
  double frame_s() const { return 1 / (settings_.f0 * time_left_); }
  double wanted_vertices(double min_cost, double max_cost) const;

  Settings settings_;
  double slope_;
  double fixed_ = 0;
  double time_left_ = 1;
  DriftingValue rest_;  ///< Times of frames minus b V.
  double planned_ = 0;
  double drawn_ = 0;          ///< V of the last frame.
  bool within_reach_ = true;  ///< Fewer vertices can hold the rate.
  int frames_against_ = 0;    ///< In a row, against within_reach_.
  std::vector<Sample> samples_;
  PlanMargin margin_;
};

/// Minimises the sum of bend pixels^2 / N with sum(cost x N) <= budget, as far as the bounds allow. Exact up to
/// rounding.
std::vector<std::uint32_t> split_budget(std::span<const ObjectView> objects, double budget);

}  // namespace eigencast
