// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/levels/lod_resolver.h"

namespace eigencast {

/// Something that pictures may do without, in steps.
struct QualityKnob {
  /// Of the last step's error and saving.
  struct Step {
    double error = 0, saved = 0;
  };
  double error = 0;         ///< What the last step adds to the difference from the full picture; the unit of all knobs.
  double saved = 0;         ///< The part of a picture's time that the last step saves; below 1.
  std::vector<Step> steps;  ///< From {0, 0}, full quality, to {1, 1}.
};

/// Parts of a picture's side in pixels, from all to the fewest that are scaled up well, and what they cost.
inline constexpr std::array<float, 13> kResolutions{1,      0.944F, 0.891F, 0.841F, 0.794F, 0.749F, 0.707F,
                                                    0.667F, 0.63F,  0.595F, 0.561F, 0.53F,  0.5F};
QualityKnob resolution_knob(double error, double saved);
/// QualityControl::Settings::vertex_error, of what half of the pixels a side change.
inline constexpr double kOfHalfTheVertices = 0.4;

/// Measures what a vertex takes, apart from what other programs take meanwhile: by pictures with few vertices, then
/// with twice as many, then with few again. Clockless. Not thread-safe.
class VertexProbe final {
 public:
  static constexpr std::size_t kPictures = 8;  ///< Of each of the three.
  static constexpr double kSure = 3.5;         ///< Standard errors.

  void start() { pictures_.emplace(); }
  void stop() { pictures_.reset(); }
  bool runs() const { return pictures_.has_value(); }
  /// The next picture is to have twice the vertices.
  bool doubles() const { return runs() && pictures_->size() / kPictures == 1; }
  struct Found {
    double vertex_s;  ///< What one takes at the least; 0 if that does not show.
    double few_s;     ///< What the picture with few takes.
  };
  /// Found after the last picture. REQUIRES: runs().
  std::optional<Found> add(double vertices, double seconds);

 private:
  struct Picture {
    double vertices, seconds;
  };
  std::optional<std::vector<Picture>> pictures_;
};

/// Keeps each picture's work within its time by what costs least to the eye: gives up, of picture quality and vertices
/// together, what adds the least image error for the time that is wanted. Clockless. Not thread-safe.
///
/// A picture takes a + b V, as of BudgetResolver, which splits V, times the product of what other steps of the knobs
/// leave, over what the present ones do. Their errors add up; fewer vertices add vertex_error (Vmax / V - 1). Of all
/// combinations that with the least error in time is taken, as the model says. Savings are estimates until measured: by
/// trial() at the start and again now and then, or, without trials, by each change.
///
/// A change needs kLearn pictures since the last one, and an error less by kBetter, or, where time is left beside all
/// vertices, any less error; one that saves time is wanted in kLearn pictures in a row. One that costs time needs a
/// wait, which doubles whenever such a change had to be undone, so that nothing oscillates.
class QualityControl final {
 public:
  static constexpr int kLearn = 4;            ///< Pictures that measure a change.
  static constexpr std::size_t kSteady = 32;  ///< Pictures whose median cost the choice is for: a gait's turn.
  static constexpr int kWait = 30;            ///< Pictures at least before quality rises.
  static constexpr int kLongestWait = 960;    ///< Likewise, at most.
  static constexpr int kTrialEvery = 1800;  ///< Pictures between trials, which hold one up, while something is lowered.
  static constexpr double kBetter = 0.1;    ///< Of the error.
  /// Of what is in sight. Fewer are drawn only where a VertexProbe has shown that this saves kWorthwhile of the time.
  static constexpr double kFewVertices = 0.2;
  static constexpr double kFreeVertices = 2000;  ///< Of all surfaces: so many are not fewer in less time, likewise.
  static constexpr double kWorthwhile = 0.05;
  static constexpr int kLongestProbeWait = 240;  ///< Pictures between probes; at first kWait, then twice as long each.

  struct Settings {
    BudgetResolver::Settings budget;
    std::vector<QualityKnob> knobs;
    double vertex_error = 0;  ///< Of half the vertices, in the knobs' unit.
    bool trials = true;       ///< The caller measures what trial() asks for.
    /// Held instead of budget.f0 while a whole picture takes more than twice its time, until it takes less than once:
    /// few whole pictures are better than many poor ones. 0: never.
    double least_f0 = 0;
  };
  explicit QualityControl(const Settings& settings);

  /// For each knob its step, for each object its level. last: the work of the last picture, drawn as chosen.
  struct Choice {
    std::vector<std::size_t> steps;
    std::vector<std::uint32_t> levels;
  };
  Choice choose(std::span<const ObjectView> objects, std::optional<FrameWork> last);

  /// A knob: beside the next picture, another one is to be drawn with the knob at its first step, or at its last if it
  /// is at the first, and the other knobs as they are. Asked once.
  std::optional<std::size_t> trial();
  /// own, other: the two pictures' times, in one unit; error: their difference. Ignored if not finite.
  void measured(std::size_t knob, double own, double other, double error);

  const std::vector<QualityKnob>& knobs() const { return settings_.knobs; }
  bool lowered() const;
  double f0() const { return f0_; }  ///< Pictures a second that are held now.
  /// The planned work of the last picture, as a part of 1 / f0.
  double state() const { return levels_.state(); }

 private:
  using Steps = std::vector<std::size_t>;
  struct Scene {
    double least, most;  ///< V
  };
  double time_left(const Steps& steps) const;
  double error_of(const Steps& steps, const Scene& scene, double budget_s) const;
  Steps best(const Scene& scene, double budget_s) const;
  double fixed_s() const;
  /// Whether knobs are measured for the first time.
  bool measures() const { return settings_.trials && next_trial_ < settings_.knobs.size(); }
  /// Raises the smallest levels to kFewVertices and kFreeVertices, unless surfaces may go below.
  void raise_least(std::vector<ObjectView>& objects);
  void note_probe(double seconds);
  void note_rest(double seconds);
  void follow_rate(const Scene& scene);
  void learn(double seconds);
  void adapt(const Scene& scene);
  void change_to(const Steps& steps);

  Settings settings_;
  double f0_;
  int against_f0_ = 0;  ///< Pictures in a row.
  BudgetResolver levels_;
  Steps steps_;
  std::vector<double> rests_;  ///< Of the last kSteady pictures: what all but vertices would take at full quality.
  double median_rest_ = 0;
  std::vector<double> ratios_;          ///< Of times to predictions since a change.
  std::optional<std::size_t> changed_;  ///< The knob that saves most of those that changed.
  double changed_part_ = 0;             ///< Of that knob's saving, by the lower step.
  std::size_t next_trial_ = 0;
  bool trial_wanted_ = false;
  int pictures_ = 0, since_change_ = 0, since_trial_ = 0, late_ = 0, wait_ = kWait;
  bool rose_ = false;  ///< By the last change.
  VertexProbe probe_;
  double vertex_s_ = 0, few_s_ = 0;  ///< VertexProbe::Found at full quality.
  int since_probe_ = 0, probe_wait_ = 0;
};

}  // namespace eigencast
