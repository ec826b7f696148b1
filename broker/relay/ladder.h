// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/wire/control.h"

namespace eigencast::broker {

/// Adapts one viewer's profile to its link. The rungs lead from the requested profile over linear interpolation, which
/// needs no residuals, and raw keys down to fewer and fewer bands. A viewer that skips many frames, or needs joins
/// repeatedly, goes down. One that gets every frame for a while goes up, after a longer while each time it relapsed. A
/// reader that takes nothing keeps its rung: it costs nothing, and gets a join when it resumes. Not thread-safe.
class Ladder {
 public:
  struct Counts {
    std::uint64_t sent = 0;
    std::uint64_t dropped = 0;
    std::uint64_t joins = 0;  ///< Among those sent.
  };
  struct Step {
    Profile profile;
    bool down = false;
    const char* rung = "";  ///< The new rung, for metrics: "asked", "linear", "raw", "fewer-bands".
    std::string why;        ///< For people.
  };

  explicit Ladder(const Profile& asked);

  /// Call once a second. `bands`: those of the stream. Returns the step to take now, if any.
  std::optional<Step> check(const Counts& counts, std::uint8_t bands);

  std::size_t rung() const { return rung_; }
  const Profile& asked() const { return requested_; }

 private:
  std::optional<Step> descend(const Counts& lately, const std::vector<Profile>& rungs);
  std::optional<Step> climb(const std::vector<Profile>& rungs);

  Profile requested_;
  Counts seen_;
  std::size_t rung_ = 0;
  std::uint16_t bad_seconds_ = 0;
  std::uint16_t good_seconds_ = 0;
  std::uint16_t climbs_after_;  ///< Good seconds; doubles after a relapse.
  bool climbed_lately_ = false;
};

}  // namespace eigencast::broker
