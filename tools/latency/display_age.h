// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "tools/latency/hdr_histogram.h"

namespace eigencast::latency {

/// How old the pose on display is, sampled once a millisecond: what a person sees. Not thread-safe.
class DisplayAge {
 public:
  void show(TimeUs capture_us, TimeUs shown_us);
  const HdrHistogram& ages_us() const { return ages_us_; }

 private:
  struct Shown {
    TimeUs capture_us = 0, since_us = 0;
  };
  std::optional<Shown> shown_;
  HdrHistogram ages_us_;
};

}  // namespace eigencast::latency
