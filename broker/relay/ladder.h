// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/wire/control.h"

namespace eigencast::broker {

/// Decides which profile the link of one viewer bears: the rungs lead from what it asked for, over compact
/// interpolation and raw keys, down to fewer and fewer bands. Who skips many frames, or needs join frames again and
/// again, goes down; who gets everything for a while goes up again, after a longer while each time that it did not
/// last. A reader that takes nothing at all stays where it is: it costs nothing, and is told the present pose when it
/// wakes.
///
/// Looks at counts, a second at a time; no clock, no sockets. Not thread-safe.
class Ladder {
 public:
  /// What happened since the viewer watches; each only grows.
  struct Counts {
    std::uint64_t sent = 0;
    std::uint64_t skipped = 0;
    std::uint64_t joins = 0;  ///< Among those sent.
  };
  struct Step {
    Profile profile;
    bool down = false;
    const char* rung = "";  ///< Where it leads, for metrics: "asked", "compact", "raw", "fewer-bands".
    std::string why;        ///< For people.
  };

  /// asked  what the viewer wants: the top rung
  explicit Ladder(const Profile& asked);

  /// Once a second. `bands`: what the stream has. The step to take now, if any.
  std::optional<Step> look(const Counts& counts, std::uint8_t bands);
  /// The step of look() could not be taken: it stands where it stood.
  void stay();

  std::size_t rung() const { return rung_; }

 private:
  const char* name_of(const Profile& rung) const;
  static std::vector<Profile> rungs_below(const Profile& asked, std::uint8_t bands);
  std::optional<Step> descend(const Counts& lately, const std::vector<Profile>& rungs);
  std::optional<Step> climb(const std::vector<Profile>& rungs);

  Profile asked_;
  Counts seen_;
  std::size_t rung_ = 0;
  std::size_t before_ = 0;
  std::uint16_t bad_seconds_ = 0;
  std::uint16_t good_seconds_ = 0;
  std::uint16_t climbs_after_;  ///< Good seconds; doubles when a climb did not last.
  bool climbed_lately_ = false;
};

}  // namespace eigencast::broker
