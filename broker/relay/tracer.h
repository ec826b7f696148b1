// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <optional>
#include <set>
#include <unordered_map>
#include <vector>

#include "broker/relay/frame.h"
#include "common/wire/control.h"

namespace eigencast::broker {

class Watcher;

/// The shorter of two intervals between traced keys; 0: none.
inline std::uint32_t shorter_interval(std::uint32_t a, std::uint32_t b) {
  return a == 0 || b == 0 ? std::max(a, b) : std::min(a, b);
}

/// Selects the traced frames of a stream for each watcher; builds the broker's part of traces. Not thread-safe.
class Tracer {
 public:
  /// Requests traces for `who` of keys whose sequence is a multiple of `every`; 0: none.
  void want(Watcher& who, std::uint32_t every);
  std::vector<Watcher*> who_wants(std::uint64_t sequence) const;
  std::uint32_t every() const { return intervals_.empty() ? 0 : *intervals_.begin(); }
  bool is_traced(std::uint64_t sequence) const { return every() != 0 && sequence % every() == 0; }

  void note_key(std::uint64_t sequence, TimeUs arrival_us);
  /// The broker's stages of a frame; nothing if it was not written, is not traced, or its key is too old.
  std::optional<control::Trace> trace_of(const Frame& frame) const;

 private:
  struct Arrival {
    std::uint64_t sequence;
    TimeUs arrival_us;
  };
  std::unordered_map<Watcher*, std::uint32_t> wanted_;
  std::multiset<std::uint32_t> intervals_;  ///< Those of wanted_.
  std::deque<Arrival> arrivals_;            ///< The newest keys; bounded.
};

}  // namespace eigencast::broker
