// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <memory>
#include <string_view>
#include <vector>

#include "broker/relay/shares.h"
#include "broker/storage/recorder.h"

namespace eigencast::broker {

/// What viewers may see again while streams run (see PastReader), and who does. Thread-safe.
struct History {
  /// Without streams nothing is kept, and what was is removed.
  History(const Recorder::Settings& settings, AssetStore& assets, const LogSink& log);

  bool keeps(std::string_view stream) const { return kept && kept->keeps(stream); }
  /// Of a stream, by its time on the steady clock. Adds about how long that took to `work_us`.
  control::History of(std::string_view stream, TimeUs now_us, double* work_us = nullptr) const;

  std::unique_ptr<Recorder> kept;        ///< Null: nothing.
  Shares viewers;                        ///< Of the past.
  std::atomic<std::uint32_t> epochs{0};  ///< That they saw.
};

}  // namespace eigencast::broker
