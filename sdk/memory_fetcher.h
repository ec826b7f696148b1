// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "common/codec/pose_memory.h"
#include "common/core/log.h"
#include "common/core/memory_budget.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "sdk/asset_fetcher.h"

namespace eigencast {

/// Fetches the segments of a viewer's memory. They are poses of people: nothing is kept on the disk. Downloads run on
/// the fetcher's thread; everything else happens in the calls. Use from one thread.
class MemoryFetcher {
 public:
  /// wake  is called on the fetcher's thread
  /// budget  outlives it
  MemoryFetcher(std::function<void()> wake, LogSink log, MemoryBudget& budget)
      : log_(log), budget_(budget), fetcher_({}, std::move(wake), std::move(log)) {}

  void use(const BrokerUrl& broker) { fetcher_.use(broker); }
  /// What is wanted from now on, all of its segments; those that are here already are not fetched again.
  /// REQUIRES: use().
  void want(control::Remember memory, const control::StreamInfo& info);
  /// Takes the segments that have come. True: the memory has all; once for each want().
  bool add_segments();

  const control::Remember& wanted() const { return wanted_; }
  std::uint64_t fetched_bytes() const { return fetcher_.stats().downloaded_bytes; }
  const PoseMemory& poses() const { return *poses_; }  ///< REQUIRES: add_segments() was true.

 private:
  Result<void> add(ByteView bytes);
  void give_up(const Error& why);

  const LogSink log_;
  MemoryBudget& budget_;
  control::Remember wanted_;
  std::string asset_;
  std::optional<PoseMemory> poses_;  ///< Of the first added_ segments.
  std::size_t added_ = 0;
  bool complete_ = true;
  MemoryBudget::Share memory_;
  AssetFetcher fetcher_;  ///< Last, so that it ends first.
};

}  // namespace eigencast
