// SPDX-License-Identifier: MIT
#include "broker/relay/moments.h"

#include <algorithm>
#include <cstdlib>

namespace eigencast::broker {
namespace {

// Of what peers say: sums of two do not overflow.
constexpr TimeUs kFarthestUs = TimeUs{1} << 61;

TimeUs bounded(TimeUs lag_us) {
  return std::clamp(lag_us, -kFarthestUs, kFarthestUs);
}

}  // namespace

std::optional<TimeUs> Moments::Stream::fastest() const {
  if (!fastest_us || !before_us) return fastest_us ? fastest_us : before_us;
  return std::min(*fastest_us, *before_us);
}

void Moments::Stream::advance(TimeUs now_us) {
  const TimeUs most = std::max<TimeUs>(0, now_us - at_us) / kSlew;
  if (!shown_us || std::abs(*goal_us - *shown_us) > kStrayUs) shown_us = goal_us;
  *shown_us += std::clamp(*goal_us - *shown_us, -most, most);
  at_us = std::max(at_us, now_us);
}

Moments::Seat Moments::join(const std::string& group, const std::string& stream) {
  const std::lock_guard lock(mutex_);
  const Entry joined = groups_.try_emplace(group).first;
  joined->second.viewers[++last_].stream = stream;
  ++joined->second.streams[stream].viewers;
  seats_[last_] = joined;
  return last_;
}

void Moments::leave(Seat seat) {
  const std::lock_guard lock(mutex_);
  const auto found = seats_.find(seat);
  if (found == seats_.end()) return;
  const Entry entry = found->second;
  Group& group = entry->second;
  const auto viewer = group.viewers.find(seat);
  const auto stream = group.streams.find(viewer->second.stream);
  if (--stream->second.viewers == 0) group.streams.erase(stream);
  group.viewers.erase(viewer);
  seats_.erase(found);
  if (group.viewers.empty()) groups_.erase(entry);
}

void Moments::note_arrival(Seat seat, TimeUs lag_us, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  const auto found = seats_.find(seat);
  if (found == seats_.end()) return;
  Group& group = found->second->second;
  Stream& stream = group.streams.at(group.viewers.at(seat).stream);
  lag_us = bounded(lag_us);
  const bool stray = stream.fastest() && std::abs(lag_us - *stream.fastest()) > kStrayUs;
  if (stray || now_us - stream.window_us >= kWindowUs) {
    stream.before_us = stray ? std::nullopt : stream.fastest_us;
    stream.fastest_us.reset();
    stream.window_us = now_us;
  }
  stream.fastest_us = std::min(stream.fastest_us.value_or(lag_us), lag_us);
}

void Moments::report(Seat seat, TimeUs needed_lag_us, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  const auto found = seats_.find(seat);
  if (found == seats_.end()) return;
  Viewer& viewer = found->second->second.viewers.at(seat);
  viewer.needs_us = bounded(needed_lag_us);
  viewer.said_us = now_us;
}

void Moments::refresh(Group& group, TimeUs now_us, TimeUs max_delay_us) {
  group.refreshed_us = now_us;
  TimeUs delay = 0;
  for (const auto& [seat, viewer] : group.viewers) {
    const auto fastest = group.streams.at(viewer.stream).fastest();
    if (fastest && viewer.said_us && now_us - *viewer.said_us < kForgetUs)
      delay = std::max(delay, viewer.needs_us - *fastest);
  }
  delay = std::min(delay, max_delay_us);
  for (auto& [name, stream] : group.streams) {
    const auto fastest = stream.fastest();
    if (!fastest) continue;
    if (stream.goal_us) stream.advance(now_us);  // Towards the goal that was true meanwhile.
    stream.goal_us = *fastest + delay;
  }
}

std::optional<TimeUs> Moments::lag_us(Seat seat, TimeUs now_us, TimeUs max_delay_us) {
  const std::lock_guard lock(mutex_);
  const auto found = seats_.find(seat);
  if (found == seats_.end()) return std::nullopt;
  Group& group = found->second->second;
  if (!group.refreshed_us || now_us - *group.refreshed_us >= kRefreshUs) refresh(group, now_us, max_delay_us);
  Stream& stream = group.streams.at(group.viewers.at(seat).stream);
  if (!stream.goal_us) return std::nullopt;
  stream.advance(now_us);
  return stream.shown_us;
}

}  // namespace eigencast::broker
