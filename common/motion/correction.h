// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Moves a wrongly shown pose to the right one without a jump (projective blending of dead reckoning: Murphy 2011,
/// "Believable dead reckoning for networked games"): the motion is right at once, and the error fades within kBlendUs,
/// by at most error / kBlendUs per microsecond.
///
/// Time comes in as arguments. Not thread-safe.
class Correction {
 public:
  static constexpr TimeUs kBlendUs = 150'000;

  /// At `now_us` the shown pose is off by `error` (shown minus right), in addition to what still fades. An error of
  /// another size replaces the old one.
  void add(std::span<const double> error, TimeUs now_us);
  /// Adds what remains of the errors at `now_us` to the right pose. Does not change a pose of another size.
  void apply(std::span<double> pose, TimeUs now_us) const;
  /// Whether apply() would change anything.
  bool active(TimeUs now_us) const { return !error_.empty() && remaining(now_us) > 0; }
  void reset() { error_.clear(); }

 private:
  double remaining(TimeUs now_us) const;

  std::vector<double> error_;  ///< At since_us_.
  TimeUs since_us_ = 0;
};

}  // namespace eigencast
