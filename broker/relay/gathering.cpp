// SPDX-License-Identifier: MIT
#include "broker/relay/gathering.h"

namespace eigencast::broker {
namespace {
constexpr TimeUs kPeriodUs = 100'000;
}

bool Gathering::waits(std::uint64_t poses, TimeUs now_us) {
  if (settings_.tick_us == 0) return false;
  const TimeUs passed = now_us - period_start_us_;
  if (passed >= kPeriodUs) {
    const std::uint64_t limit = settings_.above_per_second / (waits_ ? 2 : 1);
    waits_ = poses_ * 1'000'000 > limit * static_cast<std::uint64_t>(passed);
    poses_ = 0;
    period_start_us_ = now_us;
  }
  poses_ += poses;
  return waits_;
}

}  // namespace eigencast::broker
