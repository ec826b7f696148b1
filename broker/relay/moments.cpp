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
  const auto joined = groups_.try_emplace(group).first;
  const auto watched = joined->second.streams.try_emplace(stream).first;
  ++joined->second.viewers;
  ++watched->second.viewers;
  viewers_.emplace(++last_, Viewer{joined, watched});
  return last_;
}

void Moments::leave(Seat seat) {
  const std::lock_guard lock(mutex_);
  const auto found = viewers_.find(seat);
  if (found == viewers_.end()) return;
  const auto [entry, stream] = found->second;
  viewers_.erase(found);
  Group& group = entry->second;
  group.waited_for.erase(seat);
  if (--stream->second.viewers == 0) group.streams.erase(stream);
  if (--group.viewers == 0) groups_.erase(entry);
}

void Moments::note_arrival(Seat seat, TimeUs lag_us, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  const auto found = viewers_.find(seat);
  if (found == viewers_.end()) return;
  Stream& stream = found->second.stream->second;
  lag_us = bounded(lag_us);
  const bool stray = stream.fastest() && std::abs(lag_us - *stream.fastest()) > kStrayUs;
  if (stray || now_us - stream.window_us >= kWindowUs) {
    stream.before_us = stray ? std::nullopt : stream.fastest_us;
    stream.fastest_us.reset();
    stream.window_us = now_us;
  }
  stream.fastest_us = std::min(stream.fastest_us.value_or(lag_us), lag_us);
}

void Moments::report(Seat seat, const std::string& holder, TimeUs needed_lag_us, TimeUs now_us) {
  const std::lock_guard lock(mutex_);
  const auto found = viewers_.find(seat);
  if (found == viewers_.end()) return;
  Group& group = found->second.group->second;
  auto known = group.waited_for.find(seat);
  if (known == group.waited_for.end()) {
    if (!group.places.fits(holder, 1, kMaxWaitedFor)) return;
    known = group.waited_for.emplace(seat, WaitedFor{&found->second.stream->second, 0, 0, {}}).first;
    known->second.place = group.places.hold(holder, 1);
  }
  known->second.needs_us = bounded(needed_lag_us);
  known->second.said_us = now_us;
}

void Moments::refresh(Group& group, TimeUs now_us, TimeUs max_delay_us) {
  group.refreshed_us = now_us;
  TimeUs delay_us = 0;
  std::erase_if(group.waited_for, [&](const auto& one) {
    const WaitedFor& viewer = one.second;
    if (now_us - viewer.said_us >= kForgetUs) return true;
    if (const auto fastest = viewer.stream->fastest()) delay_us = std::max(delay_us, viewer.needs_us - *fastest);
    return false;
  });
  group.delay_us = std::min(delay_us, max_delay_us);
}

std::optional<TimeUs> Moments::lag_us(Seat seat, TimeUs now_us, TimeUs max_delay_us) {
  const std::lock_guard lock(mutex_);
  const auto found = viewers_.find(seat);
  if (found == viewers_.end()) return std::nullopt;
  Group& group = found->second.group->second;
  if (!group.refreshed_us || now_us - *group.refreshed_us >= kRefreshUs) refresh(group, now_us, max_delay_us);
  Stream& stream = found->second.stream->second;
  if (stream.goal_us) stream.advance(now_us);  // Towards the goal that was true meanwhile.
  if (const auto fastest = stream.fastest()) stream.goal_us = *fastest + group.delay_us;
  if (!stream.goal_us) return std::nullopt;
  stream.advance(now_us);
  return stream.shown_us;
}

TimeUs Moments::delay_us(Seat seat) {
  const std::lock_guard lock(mutex_);
  const auto found = viewers_.find(seat);
  if (found == viewers_.end()) return 0;
  const Stream& stream = found->second.stream->second;
  const auto fastest = stream.fastest();
  return fastest && stream.shown_us ? *stream.shown_us - *fastest : 0;
}

}  // namespace eigencast::broker
