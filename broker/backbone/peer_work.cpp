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

PeerWork::Work* PeerWork::work_of(WorkByBroker& all, const Limit& limit, std::string_view broker, TimeUs now_us) {
  const auto is_over = [&](const Work& other) {
    return other.most_us == 0 || now_us - other.since_us >= limit.period_us;
  };
  Work* work = slot_of(all, broker, is_over);
  if (work == nullptr || !is_over(*work)) return work;
  Work next{now_us, 0, fair_share(*work, limit), {}};
  const TimeUs periods = (now_us - work->since_us) / limit.period_us;
  for (const auto& [name, sender] : work->senders) {
    const std::int64_t owed_us = sender.used_us - periods * work->most_us;
    if (owed_us <= 0) continue;
    next.senders.emplace(name, Work::Sender{owed_us, owed_us});
    next.used_us += std::min(owed_us, next.most_us);
  }
  next.used_us = std::max(next.used_us, work->used_us - periods * limit.all_us);
  *work = std::move(next);
  return work;
}

bool PeerWork::take_change(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us) {
  Work* changes = work_of(changes_, kChangeLimit, broker, now_us);
  if (changes == nullptr) return false;
  Work::Sender& own = changes->senders[sender];
  const auto asked_us = static_cast<std::int64_t>(std::ceil(work_us));
  own.asked_us += asked_us;
  if (own.used_us >= changes->most_us || changes->used_us >= kChangesUs) return false;
  own.used_us += asked_us;
  changes->used_us += asked_us;
  return true;
}

void PeerWork::charge_frames(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us) {
  Work* frames = work_of(frames_, kFrameLimit, broker, now_us);
  if (frames == nullptr) return;
  const auto charged_us = static_cast<std::int64_t>(std::ceil(work_us));
  Work::Sender& own = frames->senders[sender];
  own.used_us += charged_us;
  own.asked_us += charged_us;
  frames->used_us += charged_us;
}

bool PeerWork::take_frame(std::string_view broker, const std::string& sender, double work_us, TimeUs now_us) {
  Work* frames = work_of(frames_, kFrameLimit, broker, now_us);
  if (frames == nullptr) return false;
  Work::Sender& own = frames->senders[sender];
  const auto asked_us = static_cast<std::int64_t>(std::ceil(work_us));
  own.asked_us += asked_us;
  if (own.used_us + asked_us > frames->most_us || frames->used_us + asked_us > kFramesUs) return false;
  own.used_us += asked_us;
  frames->used_us += asked_us;
  return true;
}

std::int64_t PeerWork::fair_share(const Work& before, const Limit& limit) {
  std::vector<std::int64_t> asked;
  for (const auto& [name, sender] : before.senders) asked.push_back(sender.asked_us);
  std::sort(asked.begin(), asked.end());
  std::int64_t left_us = limit.all_us, others = std::ssize(asked) + 1;
  for (const std::int64_t asked_us : asked) {
    if (asked_us > left_us / others) break;
    left_us -= asked_us;
    --others;
  }
  return std::min(left_us / others, limit.all_us / 2);
}

}  // namespace eigencast::broker
