// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// What one vertex more takes from a surface's error at a level.
struct LevelGain {
  double rows = 1;  ///< The level.
  double gain = 1;  ///< > 0
};

struct LevelError {
  std::uint32_t rows = 0;
  double error = 0;
};

/// For each level from one that errors are known of to the next. errors: ascending by rows; the error at `most`, all
/// rows, is 0. Made to fall as rows grow, as means of neighbours. Empty if there is nothing to tell from.
std::vector<LevelGain> gains_from_errors(std::span<const LevelError> errors, std::uint32_t most);

struct ObjectView {
  std::uint32_t max = 0;    ///< Largest level that can be drawn now, vertices.
  std::uint32_t min = 0;    ///< Smallest level that may be drawn; <= max.
  double distance = 0;      ///< From the eye to the barycentre of the pose; scene units, >= 0.
  double pixels = 0;        ///< Diameter on the screen; 0 if out of sight.
  double vertex_cost = 1;   ///< Relative cost of a vertex; > 0.
  std::uint32_t drawn = 0;  ///< In the last frame, which may lag behind the resolved level; 0: as resolved.
  /// Of its geometric error over its diameter, falling with rows. Between them rows are linear in 1 / sqrt(gain);
  /// beyond them the gain goes as 1 / rows^2. Empty: 1 / rows^2.
  std::span<const LevelGain> gains = {};
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

/// Follows noisy measurements: their mean since the value last changed. Ignores outliers; kJump of them in a row on the
/// same side are a jump of the value.
class DriftingValue {
 public:
  static constexpr double kFar = 3;           ///< Standard deviations.
  static constexpr double kUsualFar = 0.25;   ///< Of the value, while they are unknown.
  static constexpr double kDrift = 3;         ///< Likewise, of the mean of the newest kFew from those before.
  static constexpr std::size_t kJump = 3;     ///< Outliers.
  static constexpr std::size_t kFew = 4;      ///< Fewer measurements give no noise.
  static constexpr std::size_t kMean = 12;    ///< Measurements at most that give the value.
  static constexpr std::size_t kWindow = 16;  ///< Differences that give the noise.

  /// True if the value has jumped.
  bool add(double measured);
  double value() const { return value_; }
  double noise() const;  ///< Standard deviation; 0 while unknown.
  /// In another unit.
  void scale(double factor);

 private:
  void forget_drifted();

  double value_ = 0, last_ = 0;
  std::vector<double> seen_, far_;   ///< Since the last change; outliers in a row.
  std::vector<double> differences_;  ///< Of one measurement to the next.
};

/// The part of a frame's time to plan for: so that 19 of 20 frames meet the deadline, and 19 of 20 use `used` of it. Of
/// noise that leaves no such part the second holds. It changes slowly, so that levels stay.
class PlanMargin {
 public:
  static constexpr std::size_t kWindow = 64;            ///< Frames.
  static constexpr std::size_t kMinFrames = 16;         ///< Fewer give no statistics.
  static constexpr double kEdge = 0.97;                 ///< Upper bound, of the deadline.
  static constexpr double kFall = 0.01, kRise = 0.004;  ///< Largest change by a frame.

  PlanMargin(double deadline, double used)
      : deadline_(deadline), used_(used), fill_(std::min(kEdge * deadline / 1.05, 1.0)) {}
  /// ratio: the time of a frame over its prediction; > 0.
  void add(double ratio);
  double fill() const { return fill_; }

 private:
  double wanted() const;

  double deadline_, used_, fill_;
  std::vector<double> ratios_;
};

/// Keeps each frame's work within its time, and spends that time where it is seen.
///
/// The model of a frame's cost is a + b V, where V sums cost x N over the objects. b follows what changes of V change,
/// the more the larger they are beside those that it knows: it stays while V stays. a is a DriftingValue, so that a
/// step of the load is answered within a few frames and noise is not. V follows from the budget, and stays where the
/// model says that between kUnder less and kOver more of the planned time are used. See split_budget() for its parts.
///
/// If a alone exceeds a frame's time for kPatience frames at the smallest V, no V holds the rate: then the vertices may
/// take kShare of the time at the smallest V, until the model says as long that the smallest V would be in time again.
///
/// V grows by at most kGrowth a frame, and besides by what scale_costs() saves. It shrinks to no less than the part of
/// it that would be in time if it took all of the last frame's time, and to kLeastFall at most in a frame.
class BudgetResolver final : public LodResolver {
 public:
  static constexpr double kGrowth = 1.15;
  static constexpr double kLeastFall = 0.9;
  static constexpr double kUnder = 0.025, kOver = 0.02;
  static constexpr double kShare = 0.25;  ///< See above.
  static constexpr int kPatience = 8;     ///< Frames.

  struct Settings {
    double f0 = 60;            ///< Wanted frames per second.
    double deadline = 1;       ///< In times of 1 / f0: see PlanMargin.
    double used = 0.83;        ///< Likewise.
    double start_cost = 1e-7;  ///< Seconds per vertex, before the first measurement.
  };

  explicit BudgetResolver(const Settings& settings);

  std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last) override;
  /// The planned work of the last frame, as a part of 1 / f0.
  double state() const override { return planned_; }

  /// From now on frames take `factor` times what they took.
  void scale_costs(double factor);
  void set_f0(double f0) { settings_.f0 = f0; }
  double fixed_s() const { return fixed_; }       ///< a
  double slope_s() const { return slope_; }       ///< b
  double drawn() const { return drawn_; }         ///< V of the last frame.
  double fill() const { return margin_.fill(); }  ///< The part of 1 / f0 to plan for.

 private:
  static constexpr double kFirstShare = 0.4;  ///< Of the first frame's time, for the vertices.
  static constexpr double kKnown = 0.15;      ///< Of b: it is never known better.
  static constexpr double kLittle = 0.02;     ///< Of V: smaller changes say nothing.
  static constexpr double kGain = 0.2;        ///< Of the means.

  void learn(double seconds, double max_cost);
  void judge(double min_cost, double seconds);
  double frame_s() const { return 1 / settings_.f0; }
  double wanted_vertices(double min_cost, double max_cost) const;

  Settings settings_;
  double slope_;
  double fixed_ = 0;
  double mean_v_ = 0, mean_t_ = 0, weight_ = 0;  ///< Of the last frames; the change of V that slope_ is worth.
  DriftingValue rest_;                           ///< Times of frames minus b V.
  double planned_ = 0;
  double drawn_ = 0;                  ///< V of the last frame.
  double growth_ = kGrowth;           ///< Of V, at most, by the next frame.
  double wanted_ = 0, resolved_ = 0;  ///< What V was to be, and was but for vertices that still vanish.
  bool within_reach_ = true;          ///< Fewer vertices can hold the rate.
  int frames_against_ = 0;            ///< In a row, against within_reach_.
  int learned_ = 0;
  std::vector<double> newest_;  ///< Seconds of the last three frames.
  PlanMargin margin_;
};

/// Minimises the sum of the errors on the screen, pixels^2 times each one's geometric error, with sum(cost x N) <=
/// budget, as far as the bounds allow: so that everywhere the same time takes the same from the sum. Exact up to
/// rounding.
std::vector<std::uint32_t> split_budget(std::span<const ObjectView> objects, double budget);

}  // namespace eigencast
