// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context/context.h"
#include "broker/operation/statistics.h"

namespace eigencast::broker {

/// All metrics in Prometheus's text format, 0.0.4. Peers choose no label values, so the number of series is fixed. Call
/// on the first loop's thread with its context and the statistics of all loops.
std::string metrics_text(const Context& context, const Statistics& statistics);

}  // namespace eigencast::broker
