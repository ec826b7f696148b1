// SPDX-License-Identifier: MIT
#include "tests/support/impaired_path.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace eigencast::testing {
namespace {

// What Linux adds to the smoothed round trip before it sends again (TCP_RTO_MIN).
constexpr TimeUs kMinRetransmitUs = 200'000;
constexpr int kMaxLossesInARow = 6;

}  // namespace

Result<void> check_impairment(const Impairment& i) {
  const auto refuse = [](const char* what) { return fail(ErrorCode::kInvalidArgument, std::string("link: ") + what); };
  if (i.delay_us < 0 || i.jitter_us < 0) return refuse("delay and jitter must not be negative");
  if (i.jitter_us > i.delay_us) return refuse("the jitter must not exceed the delay: nothing leaves before it came");
  if (!std::isfinite(i.rate_bit_per_s) || i.rate_bit_per_s < 0)
    return refuse("the rate must be positive, or 0 for none");
  if (!(i.loss >= 0 && i.loss <= 0.5)) return refuse("the loss must be 0 to 0.5");
  if (i.retransmit_us < 0 || i.stall_us < 0 || i.stall_every_us < 0) return refuse("times must not be negative");
  if (i.stall_us > 0 && i.stall_every_us <= i.stall_us)
    return refuse("a stall must be shorter than the time between stalls");
  return {};
}

ImpairedPath::ImpairedPath(const Impairment& impairment) : impairment_(impairment), random_(impairment.seed) {
  assert(check_impairment(impairment));
}

TimeUs ImpairedPath::leaves_at(Flow& flow, std::size_t bytes, TimeUs now_us) {
  if (start_us_ < 0) start_us_ = now_us;
  const TimeUs jitter_us = std::llround((2 * uniform() - 1) * static_cast<double>(impairment_.jitter_us));
  const TimeUs out_us = taken_at(bytes, now_us) + impairment_.delay_us + jitter_us + retransmission_us();
  return flow.last_out_us = std::max(flow.last_out_us, out_us);
}

TimeUs ImpairedPath::taken_at(std::size_t bytes, TimeUs now_us) {
  TimeUs from_us = std::max(now_us, busy_until_us_);
  if (impairment_.stall_us > 0) {
    const TimeUs into_us = (from_us - start_us_) % impairment_.stall_every_us;
    const TimeUs runs_us = impairment_.stall_every_us - impairment_.stall_us;
    if (into_us >= runs_us) from_us += impairment_.stall_every_us - into_us;
  }
  const double rate = impairment_.rate_bit_per_s;
  const TimeUs takes_us = rate > 0 ? std::llround(8e6 * static_cast<double>(bytes) / rate) : 0;
  return busy_until_us_ = from_us + takes_us;
}

TimeUs ImpairedPath::retransmission_us() {
  TimeUs wait_us =
      impairment_.retransmit_us > 0 ? impairment_.retransmit_us : kMinRetransmitUs + 2 * impairment_.delay_us;
  TimeUs total_us = 0;
  // One draw per segment where nothing is lost, so that the jitter of a seed does not depend on the loss.
  for (int i = 0; i < kMaxLossesInARow && uniform() < impairment_.loss; ++i) {
    ++lost_;
    total_us += wait_us;
    wait_us *= 2;
  }
  return total_us;
}

}  // namespace eigencast::testing
