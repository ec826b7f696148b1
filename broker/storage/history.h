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

  /// Somebody found no place among `viewers`, and one of the others' would be its share.
  void note_refused() { refused_ = true; }
  /// Whether one that has been paused so long gives its place to who was refused last.
  bool give_way(TimeUs paused_us) { return paused_us >= kLongPauseUs && refused_.exchange(false); }
  static constexpr TimeUs kLongPauseUs = 60'000'000;

  std::unique_ptr<Recorder> kept;        ///< Null: nothing.
  Shares viewers;                        ///< Of the past.
  std::atomic<std::uint32_t> epochs{0};  ///< That they saw.

 private:
  std::atomic<bool> refused_ = false;
};

}  // namespace eigencast::broker
