// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context.h"

namespace eigencast::broker {

/// All metrics in Prometheus's text format, 0.0.4. No label has a value that a peer chooses: the number of series is
/// fixed. On the loop's thread.
std::string metrics_text(const Context& context);

}  // namespace eigencast::broker
