// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include "broker/backbone/directory.h"
#include "broker/backbone/follower.h"
#include "broker/relay/stream.h"

namespace eigencast::broker {

/// Feeds one epoch of a remote stream in the role of its sender; state of following it.
class Remote final : public PublisherLink {
 public:
  enum class Phase : std::uint8_t {
    kWaiting,   ///< Requests the surface at `next_us`.
    kFetching,  ///< The surface is being copied.
    kFetched,   ///< The surface is complete; the stream can begin.
    kFollowing,
    kUnusable,  ///< Until the directory names another epoch.
  };

  Remote(Stream& stream, DirectoryEntry entry) : follower(entry.epoch), stream_(&stream), entry_(std::move(entry)) {}

  // Local senders take precedence.
  bool yields() const override { return true; }
  void on_replaced() override { stream_ = nullptr; }
  void on_watcher_count(std::uint32_t) override {}

  Stream* stream() const { return stream_; }
  void forget_stream() { stream_ = nullptr; }
  const DirectoryEntry& entry() const { return entry_; }

  Follower follower;
  Phase phase = Phase::kWaiting;
  TimeUs next_us = 0;
  TimeUs watched_us = 0;  ///< When the stream last had watchers.
  std::shared_ptr<void> subscription;

 private:
  Stream* stream_;
  DirectoryEntry entry_;
};

}  // namespace eigencast::broker
