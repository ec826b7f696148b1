// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include "broker/backbone/directory.h"
#include "broker/backbone/follower.h"
#include "broker/relay/stream.h"

namespace eigencast::broker {

/// One epoch of a stream at another broker, in the place of its sender: what Backbone knows of following it.
class Remote final : public PublisherLink {
 public:
  enum class Phase : std::uint8_t {
    kWaiting,   ///< For `next_us`, then the surface is asked for.
    kFetching,  ///< The surface is on its way.
    kFetched,   ///< All is there, the stream can begin.
    kFollowing,
    kUnusable,  ///< Until the directory names another epoch.
  };

  Remote(Stream& stream, DirectoryEntry entry) : follower(entry.epoch), stream_(&stream), entry_(std::move(entry)) {}

  // A sender of this broker's own comes before what others say.
  bool yields() const override { return true; }
  void on_replaced() override { stream_ = nullptr; }
  void on_watcher_count(std::uint32_t) override {}

  /// Null once the stream is no longer this one's to feed.
  Stream* stream() const { return stream_; }
  void forget_stream() { stream_ = nullptr; }
  const DirectoryEntry& entry() const { return entry_; }

  Follower follower;
  Phase phase = Phase::kWaiting;
  TimeUs next_us = 0;
  TimeUs watched_us = 0;  ///< When somebody was last seen to watch.
  std::shared_ptr<void> subscription;

 private:
  Stream* stream_;
  DirectoryEntry entry_;
};

}  // namespace eigencast::broker
