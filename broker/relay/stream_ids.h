// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "broker/relay/shares.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Counts something towards somebody's limit until the pointer ends. Errors: kRefused (the limit is reached).
using Charge = std::function<Result<std::shared_ptr<void>>()>;

/// State of one stream that all event loops share. Thread-safe.
struct StreamShare {
  explicit StreamShare(std::uint32_t given, std::uint8_t last_tag = 0) : id(given), tag(last_tag) {}
  void announce();
  /// A place among `max` watchers in all loops, until the pointer ends, before which the share must not.
  /// Errors: kTooLarge (none is free; the holder has its share).
  Result<std::shared_ptr<void>> take_place(const std::string& holder, std::uint32_t max);
  /// `asset` is to be prepared from now on, by none of the viewers yet.
  void begin_preparing(const std::string& asset);
  /// So many more viewers of a holder have prepared it; ignored for another than the latest asset.
  void note_prepared(const std::string& asset, const std::string& holder, std::int64_t viewers);
  /// Of nine of ten holders nine of ten viewers have: a crowd of one does not speak for the others.
  bool is_prepared();
  const std::uint32_t id;
  std::atomic<std::uint8_t> tag;              ///< Of the latest epoch.
  Shares watchers;                            ///< In all loops.
  std::atomic<std::uint32_t> generations{0};  ///< Of memories so far.
  std::mutex mutex;
  bool announced = false;        ///< GUARDED_BY(mutex)
  std::shared_ptr<void> charge;  ///< GUARDED_BY(mutex) Until it is announced: what its first viewer pays.
  std::string to_prepare;        ///< GUARDED_BY(mutex)
  std::map<std::string, std::int64_t> prepared_by;  ///< GUARDED_BY(mutex) Viewers of all loops, by holder.
};

/// Assigns stream ids, the lowest free one first: the same in every loop while any loop, or an event between loops,
/// has the share. Tags go on where an id is used again, so that the last 255 epochs of an id differ. Thread-safe.
/// Outlives the shares' charges.
class StreamIds {
 public:
  /// max_ids  frames take at most three bytes for an id; the limits of streams are below.
  explicit StreamIds(std::int64_t max_waiting = 4096, std::uint32_t max_ids = (1U << 21) - 1)
      : max_waiting_(max_waiting), max_ids_(max_ids) {}
  /// `charge`: of a viewer, taken if nobody has announced the stream and nobody pays for it yet, from the share of
  /// `holder`. Errors: kTooLarge (max_waiting, no ids left); those of `charge`.
  Result<std::shared_ptr<StreamShare>> of(std::string_view name, const Charge& charge = {},
                                          const std::string& holder = {});

 private:
  struct Slots {  ///< Outlives all shares.
    std::mutex mutex;
    std::vector<std::uint8_t> last_tags;  ///< GUARDED_BY(mutex) By id - 1.
    std::set<std::uint32_t> free;         ///< GUARDED_BY(mutex)
  };
  Result<std::shared_ptr<void>> pay(const Charge& charge, const std::string& holder);
  std::shared_ptr<StreamShare> new_share();  ///< Null: no id is free.

  const std::int64_t max_waiting_;
  const std::uint32_t max_ids_;
  const std::shared_ptr<Slots> slots_ = std::make_shared<Slots>();
  Shares waiting_;  ///< Of those who charges are of.
  std::mutex mutex_;
  std::map<std::string, std::weak_ptr<StreamShare>, std::less<>> shares_;  ///< GUARDED_BY(mutex_)
  std::size_t sweep_at_ = 64;                                              ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast::broker
