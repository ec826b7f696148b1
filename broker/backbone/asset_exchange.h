// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "broker/backbone/link.h"
#include "broker/storage/asset_store.h"

namespace eigencast::broker {

/// Copies assets between brokers' stores over a Link, object by object and in ranges; each object is verified by its
/// hash before it is visible. Concurrent requests for one asset of one owner share a transfer.
///
/// Requests and replies, little-endian:
///   'L' id[32]              -> 0 ids[32 n]: the objects that object `id` references, or 1: not found
///   'R' id[32] offset u64   -> 0 size u64, bytes from offset on, kRangeBytes or to its end; or 1
/// Belongs to the event loop; disk access runs elsewhere, of kMaxAnswers at a time: further ones are 1.
class AssetExchange {
 public:
  static constexpr std::size_t kRangeBytes = 256u << 10;
  static constexpr std::size_t kMaxReferences = 16'384;
  static constexpr std::size_t kParallel = 4;  ///< Concurrent transfers of objects.
  static constexpr std::size_t kMaxAnswers = 64;
  static constexpr TimeUs kWholeUs = 60'000'000;   ///< An asset that came whole is not asked about again for so long.
  static constexpr std::size_t kMaxWhole = 4'096;  ///< Assets of which that is known.
  /// Transfers under way: of one broker's name, and in all. Further ones are refused: each may take descriptors.
  static constexpr std::ptrdiff_t kMaxOfName = 16;
  static constexpr std::size_t kMaxTransfers = 256;
  static constexpr TimeUs kTimeoutUs = 3'000'000;

  using Work = std::function<void()>;
  using Done = std::function<void(Result<void>)>;

  /// on_disk  runs work that may block; all of it ends before the store and this object do
  /// on_loop  runs work on the event loop; thread-safe
  AssetExchange(Link& link, AssetStore& store, std::string prefix, std::function<void(Work)> on_disk,
                std::function<void(Work)> on_loop);
  ~AssetExchange() { stop(); }

  void serve(const std::string& self);
  /// Calls `done` when object `asset` and its references are in the store, at once if they are; `payer` holds what is
  /// new there. Errors: kNotFound (at the owner), kUnreachable, kTimeout, kCorrupt, kIo, kTooLarge, kRefused
  /// (at once: too many are under way).
  void fetch(const std::string& owner, const Sha256& asset, const std::string& payer, TimeUs now_us, Done done);
  const AssetStore& store() const { return store_; }
  void stop();

  std::uint64_t fetched_bytes() const { return fetched_bytes_; }

 private:
  struct Transfer;
  using TransferPtr = std::shared_ptr<Transfer>;

  using UploadPtr = std::shared_ptr<AssetStore::Upload>;

  void advance(const TransferPtr& transfer);
  void ask(const TransferPtr& transfer, char what, const Sha256& id, std::optional<std::uint64_t> offset,
           std::function<void(Bytes)> answered);
  void ask_references(const TransferPtr& transfer);
  void begin_object(const TransferPtr& transfer, const Sha256& id);
  void ask_range(const TransferPtr& transfer, const Sha256& id, const UploadPtr& upload, std::uint64_t offset);
  /// Runs `work` on the disk's threads, then `then` on the loop, or finishes with its error.
  void on_disk(const TransferPtr& transfer, std::function<Result<void>()> work, Work then);
  void finish(const TransferPtr& transfer, const Result<void>& result);

  Link& link_;
  AssetStore& store_;
  std::string prefix_;
  std::function<void(Work)> on_disk_, on_loop_;
  std::shared_ptr<void> serving_;
  std::map<std::pair<std::string, Sha256>, TransferPtr> transfers_;  ///< By owner: a slow one holds up no other.
  std::map<std::pair<std::string, Sha256>, TimeUs> whole_;           ///< When they came.
  std::size_t answering_ = 0;
  std::uint64_t fetched_bytes_ = 0;
  std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);  ///< False: late callbacks do nothing.
};

}  // namespace eigencast::broker
