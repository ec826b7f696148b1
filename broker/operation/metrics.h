// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "broker/context/context.h"

namespace eigencast::broker {

/// Totals of all event loops for the admin port: each loop adds its part on its own thread (Loops::for_each_loop).
struct Statistics {
  void add(const Context& loop);

  Counters counters;
  std::vector<std::uint64_t> connections;  ///< Open connections of each loop.
  std::uint64_t poses_failed = 0;          ///< Of the streams known.

  std::uint64_t connections_total() const;
};

/// All metrics in Prometheus's text format, 0.0.4. Peers choose no label values, so the number of series is fixed. Call
/// on the first loop's thread with its context and the statistics of all loops.
std::string metrics_text(const Context& context, const Statistics& statistics);

}  // namespace eigencast::broker
