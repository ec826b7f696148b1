// SPDX-License-Identifier: MIT
#include "broker/operation/log_throttle.h"

#include <algorithm>
#include <utility>

namespace eigencast::broker {
namespace {

std::string kind_of(std::string_view line) {
  std::string kind;
  for (const char c : line.substr(0, 160)) {
    const bool digit = c >= '0' && c <= '9';
    if (!digit || kind.empty() || kind.back() != '#') kind += digit ? '#' : c;
  }
  return kind;
}

}  // namespace

std::optional<std::uint64_t> LogThrottle::admit(std::string_view line, TimeUs now_us) {
  std::string key = kind_of(line);
  auto found = kinds_.find(key);
  if (found == kinds_.end()) {
    if (kinds_.size() >= settings_.max_kinds) {
      kinds_.erase(std::min_element(kinds_.begin(), kinds_.end(),
                                    [](const auto& a, const auto& b) { return a.second.last_us < b.second.last_us; }));
    }
    found = kinds_.emplace(std::move(key), Kind{now_us, now_us, 0, 0}).first;
  }
  Kind& kind = found->second;
  kind.last_us = now_us;
  if (now_us - kind.period_start_us >= settings_.period_us) {
    kind.period_start_us = now_us;
    kind.passed = 0;
  }
  if (kind.passed >= settings_.lines) {
    ++kind.omitted;
    return std::nullopt;
  }
  ++kind.passed;
  return std::exchange(kind.omitted, 0);
}

}  // namespace eigencast::broker
