// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <string>

#include "tools/latency/options.h"

namespace eigencast::latency {

/// Returns the exit code. Ends soon, with what it has, when `stop` is set.
int run_command(const Options& options, const std::string& version, const std::atomic<bool>& stop);

}  // namespace eigencast::latency
