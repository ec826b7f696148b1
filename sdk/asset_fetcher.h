// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/core/hash/sha256.h"
#include "common/core/log.h"
#include "common/net/url.h"
#include "sdk/asset_cache.h"

namespace eigencast {

/// Fetches objects one after the other: from the cache, else from a broker, verified by hash. A broken download goes
/// on where it stopped, until it succeeds or others are asked for. All fetchers of a broker with the same credentials
/// share a thread and a connection. Use from one thread; wake and log are called on the shared one.
class AssetFetcher final {
 public:
  struct Object {
    Sha256 id;
    std::uint64_t max_bytes = 0;  ///< Larger ones are refused.
  };
  struct Stats {
    std::uint64_t downloaded_bytes = 0, cached_bytes = 0;
    std::string trouble;  ///< Why the last try failed and when the next one starts; empty when all is well.
  };

  /// `wake` is called whenever take() or stats() has news.
  AssetFetcher(std::string cache_dir, std::function<void()> wake, LogSink log = {});
  ~AssetFetcher() { detach(); }  ///< Cancels what is under way.
  AssetFetcher(const AssetFetcher&) = delete;
  AssetFetcher& operator=(const AssetFetcher&) = delete;

  /// Goes on at this broker, if it is another one, with what is wanted.
  void use(const BrokerUrl& broker);
  /// REQUIRES: use() was called. Fetches these from now on, in this order; what was asked for before is forgotten.
  void ask(std::vector<Object> objects);
  /// The next object. At most two are kept ready: nothing is fetched ahead of a slow caller.
  std::optional<Bytes> take();
  Stats stats() const;

 private:
  class Worker;
  void detach();
  bool is_waiting() const;

  const AssetCache cache_;
  const std::function<void()> wake_;
  const LogSink log_;
  std::shared_ptr<Worker> worker_;  ///< Null before use().

  // GUARDED_BY(Worker::mutex_):
  std::uint64_t order_ = 0;  ///< Grows with each ask().
  std::deque<Object> wanted_;
  std::deque<Bytes> ready_;
  Stats stats_;
  int failures_ = 0;
  TimeUs next_try_us_ = 0;

  /// Holds part of the first object wanted. Belongs to the worker's thread.
  Bytes body_;
  std::uint64_t body_order_ = 0;
};

}  // namespace eigencast
