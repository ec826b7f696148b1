// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/wire/control.h"

namespace eigencast {

inline constexpr TimeUs kPingIntervalUs = 250'000;

/// "; next try in 400 ms", "; next try in 3.9 s", or nothing when there is none.
inline std::string try_again_in(std::chrono::milliseconds wait) {
  if (wait.count() <= 0) return {};
  const auto tenths = (wait.count() + 50) / 100;
  if (wait.count() < 1000) return "; next try in " + std::to_string(wait.count()) + " ms";
  return "; next try in " + std::to_string(tenths / 10) + (tenths < 100 ? "." + std::to_string(tenths % 10) : "") +
         " s";
}

/// Nothing: its kind is unknown here, which newer brokers may send, or it is malformed, which is logged.
inline std::optional<ControlMessage> read_control(std::string_view text, const LogSink& log) {
  auto message = control_from_text(text);
  if (message) return std::move(*message);
  if (message.error().code != ErrorCode::kUnsupported)
    eigencast::log(log, LogLevel::kWarning, "from the broker: " + message.error().message);
  return std::nullopt;
}

}  // namespace eigencast
