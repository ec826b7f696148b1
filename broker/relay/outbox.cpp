// SPDX-License-Identifier: MIT
#include "broker/relay/outbox.h"

#include <algorithm>
#include <utility>

namespace eigencast::broker {
namespace {

constexpr TimeUs kRoundTripPeriodUs = 5'000'000;

}  // namespace

bool Outbox::push_control(Text text) {
  if (control_.size() >= limits_.max_control_messages || control_bytes_ + text->size() > limits_.max_control_bytes)
    return false;
  control_bytes_ += text->size();
  control_.push_back(std::move(text));
  return true;
}

bool Outbox::push_droppable(Text text) {
  return control_.size() < limits_.max_control_messages / 4 && control_bytes_ < limits_.max_control_bytes / 4 &&
         push_control(std::move(text));
}

bool Outbox::push_pong(Text pong) {
  if (late_pong_ && push_droppable(late_pong_)) late_pong_ = nullptr;  // Never follows the newer one.
  if (!late_pong_ && push_droppable(pong)) return true;
  late_pong_ = std::move(pong);
  return false;
}

void Outbox::open_lane(std::uint32_t stream_id) {
  Lane* lane = find(stream_id);
  if (lane == nullptr) {
    const auto after =
        std::upper_bound(lanes_.begin(), lanes_.end(), stream_id,
                         [](std::uint32_t id, const Lane& other) { return id < other.stream_id; });
    lane = &*lanes_.insert(after, Lane{});
  }
  const Lane before = std::exchange(*lane, Lane{});
  lane->stream_id = stream_id;
  lane->waits = before.waits;
  lane->dropped = before.dropped;
  lane->counts = before.counts;
  open_windows();
  wait(*lane);
}

void Outbox::close_lane(std::uint32_t stream_id) {
  std::erase_if(lanes_, [&](const Lane& lane) { return lane.stream_id == stream_id; });
  std::erase(waiting_, stream_id);
  open_windows();
}

void Outbox::wait(Lane& lane) {
  if (!std::exchange(lane.waits, true)) waiting_.push_back(lane.stream_id);
}

void Outbox::offer(std::uint32_t stream_id, const FramePtr& frame) {
  Lane* lane = find(stream_id);
  if (lane == nullptr) return;
  if (frame->envelope.is_key()) {
    skip(*lane, lane->key);
    if (frame->envelope.shows()) skip(*lane, lane->pose);
    lane->key = frame;
    lane->pose_first = lane->pose != nullptr;
  } else {
    skip(*lane, lane->pose);
    lane->pose = frame;
    lane->pose_first = lane->key == nullptr;
  }
  wait(*lane);
}

void Outbox::miss(std::uint32_t stream_id, std::size_t frames) {
  Lane* lane = find(stream_id);
  if (lane == nullptr) return;
  skip(*lane, lane->key);
  skip(*lane, lane->pose);
  lane->newest.reset();
  lane->wants_join = true;
  wait(*lane);
  lane->dropped += frames;
  lane->counts.dropped += frames;
  dropped_total_ += frames;
}

std::optional<Outbox::Item> Outbox::take_control() {
  if (!control_.empty()) {
    Item item{std::move(control_.front()), nullptr};
    control_.erase(control_.begin());
    control_bytes_ -= item.text->size();
    return item;
  }
  if (late_pong_) return Item{std::exchange(late_pong_, nullptr), nullptr};
  return std::nullopt;
}

std::optional<Outbox::Item> Outbox::take(TimeUs now_us, const JoinSource& join_of) {
  if (auto control = take_control()) return control;
  if (frames_wait(now_us)) return std::nullopt;
  if (now_us >= reopen_us_) open_windows();
  while (closed_ < waiting_.size()) {
    Lane& lane = *find(waiting_[closed_]);
    if (window_closed(lane, now_us)) {
      reopen_us_ = std::min(reopen_us_, lane.last.sent_us + limits_.probe_us);
      ++closed_;
      continue;
    }
    FramePtr frame = next_of(lane, join_of);
    waiting_.erase(waiting_.begin() + static_cast<std::ptrdiff_t>(closed_));
    lane.waits = false;
    if (!frame) continue;
    if (lane.key || lane.pose) wait(lane);
    lane.wants_join = false;
    note_sent(lane, *frame, now_us);
    return Item{nullptr, std::move(frame)};
  }
  return std::nullopt;
}

FramePtr Outbox::next_of(Lane& lane, const JoinSource& join_of) {
  drop_overtaken(lane);
  FramePtr& first = first_of(lane);
  if (first && decodable(*first, lane.newest)) return std::exchange(first, nullptr);
  if (!first && !lane.wants_join) return nullptr;
  lane.wants_join = false;
  FramePtr join = join_of(lane.stream_id);
  if (!join) {
    skip(lane, lane.key);
    skip(lane, lane.pose);
    return nullptr;
  }
  ++joins_total_;
  ++lane.counts.joins;
  const std::uint64_t joined = join->envelope.sequence;
  lane.joined = joined;
  lane.joined_at = join->envelope.is_ahead() ? join->envelope.step.at : std::uint8_t{15};
  if (lane.key && lane.key->envelope.sequence <= joined) lane.key = nullptr;  // The join holds it.
  if (lane.key && !decodable(*lane.key, joined)) skip(lane, lane.key);
  if (lane.pose && !decodable(*lane.pose, lane.key ? lane.key->envelope.sequence : joined)) skip(lane, lane.pose);
  return join;
}

bool Outbox::needs_join() {
  return std::any_of(waiting_.begin() + static_cast<std::ptrdiff_t>(closed_), waiting_.end(), [&](std::uint32_t id) {
    Lane& lane = *find(id);
    const Frame* first = first_of(lane).get();
    return first != nullptr ? !decodable(*first, lane.newest) : lane.wants_join;
  });
}

void Outbox::drop_overtaken(Lane& lane) {
  if (lane.key && is_overtaken(lane, *lane.key)) lane.key = nullptr;
  if (lane.pose && is_overtaken(lane, *lane.pose)) skip(lane, lane.pose);
}

void Outbox::note_in_flight(Lane& lane) {
  if (lane.in_flight.size() == limits_.max_in_flight) {
    // The oldest, which says when the window closes, stays.
    std::size_t kept = 0;
    for (std::size_t i = 0; i < lane.in_flight.size(); i += 2) lane.in_flight[kept++] = lane.in_flight[i];
    lane.in_flight.resize(kept);
  }
  lane.in_flight.push_back(lane.last);
}

void Outbox::drop_unsent(const FramePtr& frame) {
  const Envelope& head = frame->envelope;
  Lane* lane = find(head.stream_id);
  if (lane == nullptr) return;
  --lane->counts.sent;
  std::erase_if(lane->in_flight,
                [&](const InFlight& sent) { return sent.sequence == head.sequence && sent.step == head.step; });
  open_window(*lane);
  FramePtr dropped = frame;
  // Nothing newer waits, and the lane was not opened anew since.
  const bool is_last = !head.is_key() && !lane->key && !lane->pose && lane->last.sequence == head.sequence &&
                       lane->last.step == head.step;
  if (is_last) std::swap(dropped, lane->pose);
  if (is_last || head.is_key()) wait(*lane);
  skip(*lane, dropped);
  if (!head.is_key()) return;
  lane->newest.reset();
  lane->wants_join = true;
}

void Outbox::acknowledge(const control::Ack::Item& item, TimeUs now_us) {
  Lane* lane = find(item.stream_id);
  if (lane == nullptr) return;
  if (!acknowledges_) return begin_window(*lane, item, now_us);
  auto& in_flight = lane->in_flight;
  const auto before_us = round_trip_us();
  const auto match = std::find_if(in_flight.rbegin(), in_flight.rend(), [&](const InFlight& sent) {
    return sent.sequence == item.sequence && sent.step.byte() == item.step;
  });
  if (match != in_flight.rend()) {
    note_round_trip(now_us - match->sent_us, now_us);
    in_flight.erase(in_flight.begin(), match.base());
  } else {  // It may not be among those that are remembered; what left before it has come as well.
    using Place = std::pair<std::uint64_t, int>;
    const auto place_of = [](const InFlight& sent) { return Place(sent.sequence, sent.step.at); };
    const Place place(item.sequence, item.step >> 4);
    const auto later = std::find_if(in_flight.begin(), in_flight.end(),
                                    [&](const InFlight& sent) { return place_of(sent) > place; });
    if (later == in_flight.begin() || place > place_of(lane->last)) return;
    in_flight.erase(in_flight.begin(), later);
  }
  if (in_flight.size() * 8 < in_flight.capacity()) in_flight.shrink_to_fit();
  round_trip_us() == before_us ? open_window(*lane) : open_windows();
}

void Outbox::open_window(const Lane& lane) {
  const auto end = waiting_.begin() + static_cast<std::ptrdiff_t>(closed_);
  const auto found = std::find(waiting_.begin(), end, lane.stream_id);
  if (found == end) return;
  std::rotate(found, found + 1, end);
  --closed_;
}

void Outbox::begin_window(Lane& lane, const control::Ack::Item& item, TimeUs now_us) {
  const InFlight& last = lane.last;
  if (last.sent_us < 0 || item.sequence > last.sequence) return;
  acknowledges_ = true;
  hold_from_us_ = ReaderWatch::kNever;
  if (item.sequence == last.sequence && item.step == last.step.byte())
    return note_round_trip(now_us - last.sent_us, now_us);
  lane.in_flight.push_back(last);
}

void Outbox::note_round_trip(TimeUs round_trip_us, TimeUs now_us) {
  if (now_us - period_start_us_ > kRoundTripPeriodUs) {
    if (min_round_trip_) previous_min_round_trip_ = min_round_trip_;
    min_round_trip_.reset();
    period_start_us_ = now_us;
  }
  min_round_trip_ = std::min(min_round_trip_.value_or(round_trip_us), round_trip_us);
}

std::optional<TimeUs> Outbox::round_trip_us() const {
  if (min_round_trip_ && previous_min_round_trip_) return std::min(*min_round_trip_, *previous_min_round_trip_);
  return min_round_trip_ ? min_round_trip_ : previous_min_round_trip_;
}

bool Outbox::in_flight_too_long(const Lane& lane, TimeUs now_us) const {
  if (lane.in_flight.empty()) return false;
  const TimeUs allowed = std::min(round_trip_us().value_or(0), limits_.max_round_trip_us) + limits_.window_slack_us;
  return now_us - lane.in_flight.front().sent_us > allowed && now_us - lane.last.sent_us < limits_.probe_us;
}

std::vector<Outbox::Dropped> Outbox::take_dropped(std::size_t most) {
  std::vector<Dropped> all;
  auto next = std::upper_bound(lanes_.begin(), lanes_.end(), told_dropped_,
                               [](std::uint32_t id, const Lane& lane) { return id < lane.stream_id; });
  for (std::size_t left = lanes_.size(); left > 0 && all.size() < most; --left, ++next) {
    if (next == lanes_.end()) next = lanes_.begin();
    if (next->dropped == 0) continue;
    told_dropped_ = next->stream_id;
    all.push_back({next->stream_id, std::exchange(next->dropped, 0)});
  }
  return all;
}

Ladder::Counts Outbox::counts(std::uint32_t stream_id) {
  const Lane* lane = find(stream_id);
  return lane == nullptr ? Ladder::Counts{} : lane->counts;
}

void Outbox::skip(Lane& lane, FramePtr& waiting) {
  if (!waiting) return;
  waiting = nullptr;
  ++lane.dropped;
  ++lane.counts.dropped;
  ++dropped_total_;
}

Outbox::Lane* Outbox::find(std::uint32_t stream_id) {
  const auto found = std::lower_bound(lanes_.begin(), lanes_.end(), stream_id,
                                      [](const Lane& lane, std::uint32_t id) { return lane.stream_id < id; });
  return found != lanes_.end() && found->stream_id == stream_id ? &*found : nullptr;
}

}  // namespace eigencast::broker
