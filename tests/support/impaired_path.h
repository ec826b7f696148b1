// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <random>

#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast::testing {

/// What one direction of a bad link does to what passes.
struct Impairment {
  TimeUs delay_us = 0;        ///< Added to everything.
  TimeUs jitter_us = 0;       ///< The delay is uniform in delay_us +- jitter_us; TCP's order is kept.
  double rate_bit_per_s = 0;  ///< The link's, shared by all that pass; 0: unlimited.
  double loss = 0;            ///< Probability that a segment is lost and must be sent again, 0 to 0.5.
  TimeUs retransmit_us =
      0;  ///< How long TCP takes to send a lost segment again; 0: 200 ms + 2 delay_us. Doubles per loss.
  TimeUs stall_every_us = 0;  ///< The link stops once in this time; 0: never.
  TimeUs stall_us = 0;        ///< How long it then stops.
  std::uint64_t seed = 1;
};

/// Errors: kInvalidArgument naming what is out of range.
Result<void> check_impairment(const Impairment& impairment);

/// One direction of a link: when does a segment that enters now leave again? Models what TCP makes of the link beneath
/// it: nothing is lost and nothing overtakes, so a lost segment holds up all of its connection that comes after it
/// (head-of-line blocking) until it has been sent again. The bandwidth is shared by all flows; the order is each flow's
/// own. Same seed, same calls: same answers.
///
/// Time comes in as an argument, must not go back. Not thread-safe.
class ImpairedPath {
 public:
  /// The order within one connection.
  struct Flow {
    TimeUs last_out_us = 0;
  };

  /// REQUIRES: check_impairment passed.
  explicit ImpairedPath(const Impairment& impairment);

  /// When the last of `bytes` that enter at now_us leaves.
  TimeUs leaves_at(Flow& flow, std::size_t bytes, TimeUs now_us);

  /// When the link has taken up all that was given to it: a sender that holds more back until then keeps its queue
  /// short.
  TimeUs busy_until_us() const { return busy_until_us_; }
  std::uint64_t segments_lost() const { return lost_; }

 private:
  TimeUs taken_at(std::size_t bytes, TimeUs now_us);
  TimeUs retransmission_us();
  double uniform() { return std::generate_canonical<double, 53>(random_); }

  Impairment impairment_;
  std::mt19937_64 random_;
  TimeUs start_us_ = -1;
  TimeUs busy_until_us_ = 0;
  std::uint64_t lost_ = 0;
};

}  // namespace eigencast::testing
