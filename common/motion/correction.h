// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <vector>

#include "common/core/clock.h"

namespace eigencast {

/// Lets what was shown wrongly go over to what is right without a jump (the projective blending of dead reckoning:
/// Murphy 2011, "Believable dead reckoning for networked games"): the error stays in the picture and fades within
/// kBlendUs, while the motion beneath it is the right one already. The error changes by at most error / kBlendUs per
/// microsecond.
///
/// Time comes in as arguments. Not thread-safe.
class Correction {
 public:
  static constexpr TimeUs kBlendUs = 150'000;

  /// At `now_us` what was shown turned out to be off by `error` (shown minus right), beside what still fades. An error
  /// of another size than before replaces it.
  void add(std::span<const double> error, TimeUs now_us);
  /// Adds to the right pose what of the errors is left at `now_us`. A pose of another size is left as it is.
  void apply(std::span<double> pose, TimeUs now_us) const;
  /// Whether apply() would change anything.
  bool active(TimeUs now_us) const { return !error_.empty() && left(now_us) > 0; }
  void reset() { error_.clear(); }

 private:
  double left(TimeUs now_us) const;

  std::vector<double> error_;  ///< At since_us_.
  TimeUs since_us_ = 0;
};

}  // namespace eigencast
