// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// One surface of the scene, as far as its level of detail depends on it.
struct ObjectView {
  std::uint32_t vertices = 0;  ///< Most vertices that can be drawn now.
  std::uint32_t least = 0;     ///< Fewest that may be drawn; at most `vertices`.
  double distance = 0;         ///< From the eye to the barycentre of the present pose; scene units, >= 0.
  double pixels = 0;           ///< Diameter on the screen in pixels; 0 if out of sight.
  double vertex_cost = 1;      ///< Cost of one vertex relative to the others (instances, shading, points); > 0.
  std::uint32_t drawn = 0;     ///< In the last frame, which may lag behind what was resolved; 0: as was resolved.
};

/// How long a frame took to make: the work alone, without waiting for the display.
struct FrameWork {
  TimeUs now_us = 0;   ///< When it was done.
  double seconds = 0;  ///< > 0; frames that are not finite or not positive are ignored.
};

/// Chooses how many vertices of each surface to draw in the next frame. Time and measurements come in as arguments.
/// Not thread-safe.
class LodResolver {
 public:
  virtual ~LodResolver() = default;

  /// Takes the measurement of the last frame (nothing before the first) and gives N for each object:
  /// least <= N <= vertices.
  virtual std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) = 0;

  /// What the controller holds just now, for plots: kappa of the paper, or the part of the frame that is budgeted.
  virtual double state() const = 0;
};

/// Eq. 5, Eq. 6 and Algorithm 1 of Zhang, Dou, Zhou, Wu 2013, "Streaming 3D deforming surfaces with dynamic resolution
/// control":
///
///   L_i = G(d_i) + F(f, d_i),  G = 1 - d',  F = kappa d' (kappa >= 0) or kappa (1 - d') (kappa < 0)
///
/// d' is the distance scaled to [0, 1] between `near` and `far`; kappa is one for all objects and moves by delta in
/// each interval in which the frame rate f leaves f0 +- T_f. The paper leaves the interval open: 100 ms here. L = 0
/// draws nothing there; here an object keeps its least.
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

  /// Eq. 5 with Eq. 6, clamped to [0, 1]. `scaled` is d'.
  static double level(double scaled, double kappa);

 private:
  void adjust(const FrameWork& work);

  Settings settings_;
  double kappa_ = 0;
  std::optional<TimeUs> interval_began_us_;
  double interval_work_ = 0;  ///< Seconds of work of the frames of this interval.
  int interval_frames_ = 0;
};

/// Follows a value that drifts, from measurements with noise: evenly where they differ from it by no more than they
/// usually do. One that is far off is passed over; with a second in a row the value has jumped.
class DriftingValue {
 public:
  static constexpr double kGain = 0.3;        ///< Of a measurement within the noise.
  static constexpr double kFar = 3;           ///< Standard deviations.
  static constexpr std::size_t kWindow = 16;  ///< Measurements that tell the noise.

  /// far: off by more than this it is far off, whatever the noise has been.
  void add(double measured, double far);
  double value() const { return value_.value_or(0); }

 private:
  double deviation() const;

  std::optional<double> value_;
  double last_ = 0;
  double far_before_ = 0;         ///< By how much the last one was off, if far.
  std::deque<double> distances_;  ///< Of the measurements from what was expected.
};

/// How much of a frame's time may be planned for, so that all but one frame in twenty are done by the deadline. What
/// the last frames took beside what was foretold of them says how much must be left for that; a quiet machine leaves
/// little.
class PlanMargin {
 public:
  static constexpr std::size_t kWindow = 64;  ///< Frames that count.
  static constexpr std::size_t kFew = 16;     ///< Fewer say nothing.
  static constexpr double kLeast = 0.85;      ///< Of a frame's time is planned for in any case,
  static constexpr double kEdge = 0.97;       ///< and of the deadline no more than this.

  /// deadline: in frames' times; >= 1.
  explicit PlanMargin(double deadline) : deadline_(deadline) {}
  /// Takes what a frame took, as a part of what it should have taken; > 0.
  void add(double taken);
  /// Of a frame's time, in [kLeast, 1].
  double fill() const;

 private:
  double deadline_;
  std::deque<double> taken_;
};

/// Holds the frame's work within its time and spends all of it where it is seen.
///
/// A frame costs a + b V, where V sums cost x N over the objects. Both are learnt while it runs: b by least squares
/// over the last frames, which pull it only as far as V has varied; a as a DriftingValue, so that a step of the load is
/// answered within a few and noise is not answered at all. V is then what the budget leaves, and it is split so that
/// the sum of the errors on the screen is least: what is linear between vertices is off by the square of an edge,
/// everywhere on the surface, pixels^2 / N in all, and so N ~ pixels / sqrt(cost) within its bounds.
///
/// Where a alone takes longer than a frame may, no V holds the rate, and giving the surfaces away gains nothing. That
/// is believed only on evidence: kPatience frames at the least V that were all late, for vertices that the model says
/// are not why. From then on they may take kShare of what the least V takes, and the frame be so much later, until the
/// model says as long that the least V would be in time again.
///
/// V goes up by at most kGrowth a frame, and down by no more than a frame that was late asks for, or kFall: one that
/// was late for another reason does not take all detail. Changes within kDeadBand are not made. What is out of sight is
/// drawn at its least.
class BudgetResolver final : public LodResolver {
 public:
  static constexpr double kGrowth = 1.15;
  static constexpr double kFall = 0.6;  ///< V is at least so much of what it was.
  static constexpr double kDeadBand = 0.03;
  static constexpr std::size_t kWindow = 48;  ///< Frames that the cost is learnt from.
  static constexpr double kShare = 0.25;      ///< Of the time at the least V: for vertices that cannot hold the rate.
  static constexpr int kPatience = 8;         ///< Frames.

  struct Settings {
    double f0 = 60;            ///< Wanted frames per second.
    double deadline = 1;       ///< In times of 1 / f0, when a frame is late: see PlanMargin.
    double start_cost = 1e-7;  ///< Seconds per vertex, believed before anything was measured.
  };

  explicit BudgetResolver(const Settings& settings);

  std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) override;
  /// Work of the last frame that was planned, as part of 1 / f0.
  double state() const override { return planned_; }

  double seconds_per_vertex() const { return slope_; }
  double seconds_fixed() const { return fixed_; }
  double fill() const { return margin_.fill(); }       ///< Part of 1 / f0 that is planned for.
  bool within_reach() const { return within_reach_; }  ///< Fewer vertices can hold the rate, as far as is known.

 private:
  struct Sample {
    double vertices;
    double seconds;
  };
  void learn(double seconds);
  void judge(double least, double seconds);
  double wanted_vertices(double least, double most) const;

  Settings settings_;
  double slope_;
  double fixed_ = 0;
  DriftingValue rest_;  ///< What b V leaves of the frames' times: fixed_, where it is positive.
  double planned_ = 0;
  double drawn_ = 0;  ///< V of the last frame.
  bool within_reach_ = true;
  int frames_against_ = 0;  ///< The last so many speak against within_reach_.
  std::deque<Sample> samples_;
  PlanMargin margin_;
};

/// Splits `budget` over the objects so that the sum of pixels^2 / N is least, with sum(cost x N) <= budget where the
/// bounds allow it. Exact up to rounding: objects at a bound leave the sum, the others share what is left.
std::vector<std::uint32_t> split_budget(std::span<const ObjectView> objects, double budget);

}  // namespace eigencast
