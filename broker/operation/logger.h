// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/core/log.h"

namespace eigencast::broker {

/// A sink that writes to standard error: text lines, or one JSON object a line; floods are throttled. Thread-safe.
///   level   "debug", "info", "warning" or "error"
///   format  "text" or "json"
LogSink make_log_sink(const std::string& level, const std::string& format);

}  // namespace eigencast::broker
