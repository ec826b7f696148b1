// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>

#include "common/asset/format/reader.h"
#include "common/core/bytes.h"
#include "common/core/log.h"
#include "common/core/memory_budget.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/reconstruction/reconstruct.h"
#include "common/wire/control.h"
#include "sdk/asset_fetcher.h"
#include "sdk/transfer.h"

namespace eigencast {

/// How poses go on where another asset of the same surface has replaced the one that was shown.
struct ChangeOver {
  std::uint32_t from_epoch = 0;
  Transfer transfer;
  std::shared_ptr<Reconstructor> reconstructor;  ///< Of the new asset, all of it.
};

/// The surface that a viewer shows, and the one of a newer epoch that is on its way and replaces it once it can be
/// drawn. What a stream says is to come next is fetched when that is done, and replaces it at once; of what differs
/// from what is shown by columns that the stream has learnt, these alone. Downloads run on
/// the fetcher's thread; everything else happens in the calls. Use from one thread.
class Surfaces {
 public:
  /// wake  is called on the fetcher's thread
  /// memory  bounds what the surfaces may take; it outlives them
  Surfaces(std::string cache_dir, std::function<void()> wake, LogSink log, MemoryBudget& memory);

  /// Downloads come from this broker from now on. REQUIRES: called before announce().
  void use(const BrokerUrl& broker) { fetcher_.use(broker); }
  /// True: another surface than before is on its way from now on, or none any more.
  bool announce(const control::StreamInfo& info);
  /// Takes at most one, so that no call takes long. True: there may be another one ready.
  bool add_object();

  /// The asset that is to come next, once it is here, whole; then empty until there is another.
  std::string take_prepared();
  /// How asset() replaced the one before; null: it has nothing to do with that.
  const ChangeOver* change() const { return change_ ? &*change_ : nullptr; }

  /// What is drawn; null before the first chunk of the first surface.
  const Asset* asset() const { return shown_ ? &shown_->reader->asset() : nullptr; }
  std::uint32_t epoch() const { return shown_ ? shown_->epoch : 0; }  ///< Belongs to asset(); 0 before.
  bool is_shown(std::uint32_t epoch) const { return shown_ && shown_->epoch == epoch; }
  bool is_pending(std::uint32_t epoch) const { return pending_ && pending_->epoch == epoch; }

  enum class Progress { kNone, kNotDrawable, kDrawable, kFinished };
  Progress progress() const;  ///< Follows the surface announced last.
  /// Why it can never be drawn; empty if it may.
  std::string damage() const { return latest() ? latest()->damage : std::string(); }
  std::uint64_t total_bytes() const { return latest() ? latest()->total_bytes : 0; }  ///< 0 while unknown.
  AssetFetcher::Stats fetched() const { return fetcher_.stats(); }

 private:
  struct Slot {
    std::string asset;  ///< 64 hex digits.
    std::uint32_t epoch = 0;
    StreamFormat format;                       ///< The poses', as announced last for this asset.
    std::optional<AssetReader> reader;         ///< From the manifest on.
    bool lacks_columns = false;                ///< They come before the chunks.
    std::shared_ptr<const Slot> has_chunks{};  ///< All of them, until the columns come.
    std::size_t next_chunk = 0;
    std::uint64_t total_bytes = 0;
    MemoryBudget::Share memory;
    std::string damage;
    bool changes = false;                ///< Whether `change` was asked for.
    std::optional<ChangeOver> change{};  ///< From what was shown when it was whole.

    /// The next object. Errors: those of AssetReader.
    Result<void> add(ByteView bytes);
    bool finished() const { return reader && next_chunk == reader->chunks().size(); }
    bool goes_on_as(const std::string& id) const { return asset == id && damage.empty(); }
  };

  /// Returns the slot of the newest epoch.
  const Slot* latest() const { return pending_ ? pending_.get() : shown_.get(); }
  Slot* latest() { return pending_ ? pending_.get() : shown_.get(); }
  /// The same asset may come with poses of another format.
  void adopt(Slot& slot, const control::StreamInfo& info);
  /// Damages the slot if the announced poses cannot deform its surface; true if they can.
  bool check_format_of(Slot& slot);
  /// What the next object is for.
  Slot* working();
  void prepare();
  void begin_change();
  /// Takes what begin_change() has made, if it is ready.
  void take_change();
  void ask();
  void read_manifest(Slot& slot, ByteView bytes);
  void damage(Slot& slot, const Error& why);

  const LogSink log_;
  MemoryBudget& memory_;
  std::shared_ptr<Slot> shown_;     ///< Drawable.
  std::shared_ptr<Slot> pending_;   ///< Holds the newest epoch until its first chunk is in.
  std::shared_ptr<Slot> next_;      ///< Of an epoch to come.
  std::shared_ptr<Slot> changing_;  ///< What making_ is for: goes on where that was given up.
  std::future<std::optional<ChangeOver>> making_;
  std::optional<ChangeOver> change_;
  std::string to_come_;  ///< The asset that next_ is to be, once something is shown; empty: none.
  bool told_prepared_ = false;
  AssetFetcher fetcher_;  ///< Last, so that it ends first.
};

}  // namespace eigencast
