// SPDX-License-Identifier: MIT
#include "broker/backbone/peer_work.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <vector>

#include "broker/backbone/directory.h"

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
  if (is_over(*frames)) *frames = {now_us, 0, fair_share(*frames), {}};
  Frames::Sender& own = frames->senders[sender];
  const auto asked_us = static_cast<std::int64_t>(std::ceil(work_us));
  own.asked_us += asked_us;
  if (own.used_us + asked_us > frames->most_us || frames->used_us + asked_us > kFramesUs) return false;
  own.used_us += asked_us;
  frames->used_us += asked_us;
  return true;
}

std::int64_t PeerWork::fair_share(const Frames& before) {
  std::vector<std::int64_t> asked;
  for (const auto& [name, sender] : before.senders) asked.push_back(sender.asked_us);
  std::sort(asked.begin(), asked.end());
  std::int64_t left_us = kFramesUs, others = std::ssize(asked) + 1;
  for (const std::int64_t asked_us : asked) {
    if (asked_us > left_us / others) break;
    left_us -= asked_us;
    --others;
  }
  return std::min(left_us / others, kFramesUs / 2);
}

}  // namespace eigencast::broker
