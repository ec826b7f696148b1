// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <functional>

#include "common/core/log.h"
#include "tools/latency/outcome.h"

namespace eigencast::latency {

struct Progress {
  double seconds = 0, of = 0;
  std::uint64_t keys = 0, synthetic = 0;
  std::int64_t p50_us = 0, p99_us = 0;
};
using OnProgress = std::function<void(const Progress&)>;

/// Ends by its deadline whatever is lost, sooner when `stop` is set.
/// Errors: kInvalidArgument, kUnreachable, kRefused (by the broker), kTimeout (no pose came).
Result<Outcome> run_session(const Inputs& inputs, const std::atomic<bool>& stop, const OnProgress& progress,
                            LogSink log);

}  // namespace eigencast::latency
