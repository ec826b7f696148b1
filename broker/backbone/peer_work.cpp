// SPDX-License-Identifier: MIT
#include "broker/backbone/peer_work.h"

#include <cmath>

#include "broker/backbone/directory.h"
#include "common/core/share.h"

namespace eigencast::broker {
namespace {

/// Null: too many are in use.
template <typename Map, typename IsIdle>
typename Map::mapped_type* slot_of(Map& map, std::string_view broker, IsIdle is_idle) {
  const std::string name(name_of_broker(broker));
  if (map.size() >= PeerWork::kMaxNames) std::erase_if(map, [&](const auto& item) { return is_idle(item.second); });
  if (map.size() >= PeerWork::kMaxNames && !map.contains(name)) return nullptr;
  return &map[name];
}

}  // namespace

bool PeerWork::take_row(std::string_view broker, double work_us, TimeUs now_us) {
  RateLimiter* rows = slot_of(rows_, broker, [&](const RateLimiter& other) { return other.is_idle(now_us); });
  return rows != nullptr && rows->take(work_us, kRowsUsPerS, kRowsUsPerS, now_us);
}

bool PeerWork::take_frame(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us) {
  const auto is_over = [&](const Frames& other) { return now_us - other.since_us >= kPeriodUs; };
  Frames* frames = slot_of(frames_, broker, is_over);
  if (frames == nullptr) return false;
  if (is_over(*frames)) *frames = {now_us, 0, {}};
  std::int64_t& own_us = frames->of_senders[sender];
  const auto taken_us = static_cast<std::int64_t>(std::ceil(work_us));
  if (own_us + taken_us > share_of(kFramesUs, frames->used_us, own_us)) return false;
  own_us += taken_us;
  frames->used_us += taken_us;
  return true;
}

}  // namespace eigencast::broker
