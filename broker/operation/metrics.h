// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context.h"
#include "broker/operation/facts.h"

namespace eigencast::broker {

/// All metrics in Prometheus's text format, 0.0.4. No label has a value that a peer chooses: the number of series is
/// fixed. On the first loop's thread, whose context it is; the facts are of all loops.
std::string metrics_text(const Context& context, const Facts& facts);

}  // namespace eigencast::broker
