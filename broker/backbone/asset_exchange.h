// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/backbone/link.h"
#include "broker/storage/asset_store.h"

namespace eigencast::broker {

/// Copies assets from one broker's store to another's over a Link, object by object and in ranges, each verified by its
/// hash before it is visible. Several who want the same asset share one transfer.
///
/// Questions and answers, little-endian:
///   'L' id[32]              -> 0 ids[32 n]: the objects that object `id` needs, or 1: it is not here
///   'R' id[32] offset u64   -> 0 size u64, bytes from offset on, at most kRangeBytes; or 1
///
/// Belongs to the event loop; the disk's work is done elsewhere.
class AssetExchange {
 public:
  static constexpr std::size_t kRangeBytes = 256u << 10;
  static constexpr std::size_t kMaxReferences = 16'384;
  static constexpr std::size_t kParallel = 4;  ///< Objects on their way at a time.
  static constexpr TimeUs kTimeoutUs = 3'000'000;

  using Work = std::function<void()>;
  using Done = std::function<void(Result<void>)>;

  /// on_disk  runs work where it may block; done with all of it before the store and this object end
  /// on_loop  runs work on the event loop; thread-safe
  AssetExchange(Link& link, AssetStore& store, std::string prefix, std::function<void(Work)> on_disk,
                std::function<void(Work)> on_loop);
  ~AssetExchange();

  /// Answers questions to broker `self` from now on.
  void serve(const std::string& self);
  /// Calls `done` when object `asset` and all that it needs are in the store: at once if they are. Errors: kNotFound
  /// (the owner has it not), kUnreachable, kTimeout, kCorrupt, kIo, kTooLarge.
  void fetch(const std::string& owner, const Sha256& asset, Done done);
  void stop();

  std::uint64_t fetched_bytes() const { return fetched_bytes_; }

 private:
  struct Transfer;
  using TransferPtr = std::shared_ptr<Transfer>;

  using UploadPtr = std::shared_ptr<AssetStore::Upload>;

  void go_on(const TransferPtr& transfer);
  void ask(const TransferPtr& transfer, char what, const Sha256& id, std::optional<std::uint64_t> offset,
           std::function<void(Bytes)> answered);
  void ask_references(const TransferPtr& transfer);
  void begin_object(const TransferPtr& transfer, const Sha256& id);
  void ask_range(const TransferPtr& transfer, const Sha256& id, const UploadPtr& upload, std::uint64_t offset);
  /// Runs `work` where it may block, then what it returns on the loop.
  void on_disk(const TransferPtr& transfer, std::function<Work()> work);
  void finish(const TransferPtr& transfer, const Result<void>& result);

  Link& link_;
  AssetStore& store_;
  std::string prefix_;
  std::function<void(Work)> on_disk_, on_loop_;
  std::shared_ptr<void> serving_;
  std::map<Sha256, TransferPtr> transfers_;
  std::uint64_t fetched_bytes_ = 0;
  std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);  ///< False: what comes back to the loop is late.
};

}  // namespace eigencast::broker
