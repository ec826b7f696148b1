// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "common/asset/format/reader.h"
#include "common/core/bytes.h"
#include "common/core/log.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/wire/control.h"
#include "sdk/asset_fetcher.h"

namespace eigencast {

/// The surface that a viewer shows, and the one of a newer epoch that is on its way: asks for their objects, verifies
/// them, and lets the newer replace the other once it can be drawn. Downloads run on the fetcher's thread;
/// everything else happens in the calls. Use from one thread.
class Surfaces {
 public:
  /// wake  is called, on the fetcher's thread, when add_object() has something to do
  Surfaces(const BrokerUrl& url, std::string cache_dir, std::function<void()> wake, LogSink log);

  /// The stream as it is announced (again). True: another surface than before is on its way from now on, or none any
  /// more.
  bool announce(const control::StreamInfo& info);
  /// Verifies and applies at most one object, so that no call takes long. True: there may be another one ready.
  bool add_object();

  /// What is drawn; null before the first chunk of the first surface.
  const Asset* asset() const { return shown_ ? &shown_->reader->asset() : nullptr; }
  /// Of asset(); 0 before.
  std::uint32_t epoch() const { return shown_ ? shown_->epoch : 0; }
  bool is_shown(std::uint32_t epoch) const { return shown_ && shown_->epoch == epoch; }
  /// Whether the surface of this epoch is on its way and not shown yet.
  bool is_pending(std::uint32_t epoch) const { return pending_ && pending_->epoch == epoch; }

  enum class Progress { kNone, kNotDrawable, kDrawable, kFinished };
  /// How far the surface announced last has come; kNone: none was announced.
  Progress progress() const;
  /// Why the surface announced last can never be drawn; empty if it may.
  std::string damage() const { return latest() ? latest()->damage : std::string(); }
  /// Of the surface announced last; 0 while unknown.
  std::uint64_t total_bytes() const { return latest() ? latest()->total_bytes : 0; }
  AssetFetcher::Stats fetched() const { return fetcher_.stats(); }

 private:
  /// One epoch's surface as far as it has come.
  struct Slot {
    std::string asset;  ///< 64 hex digits.
    std::uint32_t epoch = 0;
    StreamFormat format;                ///< Of the poses, as announced last for this asset.
    std::optional<AssetReader> reader;  ///< From the manifest on.
    std::size_t next_chunk = 0;
    std::uint64_t total_bytes = 0;
    std::string damage;

    bool finished() const { return reader && next_chunk == reader->chunks().size(); }
    /// Whether it is the surface of that id and nothing is wrong with it.
    bool goes_on_as(const std::string& id) const { return asset == id && damage.empty(); }
  };

  /// The surface of the newest epoch: what is being fetched, else what is shown.
  const Slot* latest() const { return pending_ ? pending_.get() : shown_.get(); }
  Slot* latest() { return pending_ ? pending_.get() : shown_.get(); }
  /// The slot's surface is announced (again): the same asset may come with poses of another format.
  void adopt(Slot& slot, const control::StreamInfo& info);
  /// Damages the slot if the announced poses cannot deform its surface; true if they can, as far as is known.
  bool check_format_of(Slot& slot);
  /// Asks for all that the latest surface still needs.
  void ask();
  void read_manifest(Slot& slot, ByteView bytes);
  void damage(Slot& slot, const Error& why);

  const LogSink log_;
  std::unique_ptr<Slot> shown_;    ///< Drawable.
  std::unique_ptr<Slot> pending_;  ///< Of the newest epoch, until its first chunk is in.
  AssetFetcher fetcher_;           ///< Last, so that it ends first.
};

}  // namespace eigencast
