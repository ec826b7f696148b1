// SPDX-License-Identifier: MIT
#include "broker/relay/hub.h"

#include <algorithm>
#include <atomic>
#include <cassert>
#include <cmath>
#include <tuple>
#include <utility>

namespace eigencast::broker {
namespace {

constexpr std::int64_t kSegmentBytes = 1024;  ///< Of a segment without poses.

bool is_idle(const Stream& stream) {
  return !stream.has_publisher() && stream.watchers_here() == 0 && !stream.is_mirrored();
}

std::int64_t memory_of(const MemorySegment& segment) {
  return kSegmentBytes + static_cast<std::int64_t>(segment.values.size() * sizeof(std::int32_t));
}

std::shared_ptr<const MemorySegment> charged(std::shared_ptr<const MemorySegment> segment,
                                             std::shared_ptr<StreamMemory> memory, const std::string& payer,
                                             std::int64_t bytes) {
  auto charge = memory->poses.hold(payer, bytes);
  const MemorySegment* poses = segment.get();
  // Others may hold it when the hub has gone: what it is charged to goes last.
  return {poses, [memory = std::move(memory), held = std::move(segment), charge = std::move(charge)](const auto*) {}};
}

Error too_many_poses(std::int64_t bytes, std::int64_t max) {
  return fail(ErrorCode::kTooLarge, "its poses take " + std::to_string(bytes) + " bytes, and of the " +
                                        std::to_string(max) +
                                        " that memory.max_bytes allows too few are free for one that holds more");
}

}  // namespace

Result<Stream*> Hub::open(std::string_view name, const Charge& charge, const std::string& holder) {
  auto share = settings_.ids->of(name, charge, holder);
  if (!share) return share.error();
  if (Stream* stream = find(name)) return stream;
  auto made = std::make_unique<Stream>(std::string(name), std::move(*share), settings_.stream);
  Stream* stream = streams_.emplace(std::string(name), std::move(made)).first->second.get();
  if (settings_.on_opened) settings_.on_opened(*stream);
  return stream;
}

Result<void> Hub::admit(Stream& stream, const StreamHolder& holder, const StreamFormat& format, const Charge& charge) {
  const bool known = stream.charge_ && stream.holder_.key == holder.key;
  auto charged = known ? stream.charge_ : charge();
  if (!charged && make_room(holder, true)) charged = charge();
  if (!charged) return charged.error();
  const auto most = static_cast<std::int64_t>(settings_.max_streams);
  const auto has_share = [&] { return !holder.stranger || strangers_.fits(holder.key, 1, most - most / 4); };
  const bool is_over = !known && !has_share() && !(make_room(holder, true) && has_share());
  if (is_over || (!stream.charge_ && admitted_ >= settings_.max_streams && !make_room(holder, false))) {
    return fail(ErrorCode::kTooLarge, "all " + std::to_string(most) + " streams that limits.max_streams allows are in" +
                                          (is_over ? " use, or left to others and to senders with tokens" : " use") +
                                          ": raise it, or stop one");
  }
  if (auto held = hold_keys(stream, holder, format); !held) return held;
  if (!known && holder.stranger) {
    charged =
        std::shared_ptr<void>(charged->get(), [paid = *charged, counted = strangers_.hold(holder.key, 1)](void*) {});
  }
  if (!stream.charge_) ++admitted_;
  stream.charge_ = std::move(*charged);
  stream.holder_ = holder;
  return {};
}

Result<void> Hub::hold_keys(Stream& stream, const StreamHolder& holder, const StreamFormat& format) {
  const std::string payer = holder.spared ? "" : holder.key;
  const std::int64_t bytes = keys_bytes(format), max = settings_.stream.max_bytes;
  Stream::Keys& own = stream.keys_;
  if (own.payer == payer && own.bytes >= bytes) return {};
  own.memory.reset();
  Shares& keys = settings_.stream.memory->keys;
  bool fits = keys.fits(payer, bytes, max);
  // Its holder's own poses make room first, then those of who has as much, if they are enough.
  while (!fits && make_room(holder, true)) fits = keys.fits(payer, bytes, max);
  if (!fits) fits = make_room_of_keys(holder, payer, bytes);
  if (fits) own = {payer, bytes, nullptr};
  if (own.bytes > 0) own.memory = keys.hold(own.payer, own.bytes);
  if (fits) return {};
  return fail(ErrorCode::kTooLarge, "its keys take up to " + std::to_string(bytes) + " bytes, and of the " +
                                        std::to_string(max) + " that limits.max_stream_bytes allows too few are free " +
                                        "for one that holds more: send fewer streams or coefficients, or raise it");
}

Result<void> Hub::remember(Stream& stream, std::vector<Generation::Segment> segments) {
  const Generation* before = stream.memory().get();
  const std::uint32_t number = ++stream.share()->generations;
  Generation next{number, before != nullptr ? before->root : number,
                  before != nullptr ? before->poses : PoseMemory(stream.layout()), std::move(segments)};
  const auto bytes_of = [&](const Generation::Segment& segment) {
    return memory_of(*segment.poses) + static_cast<std::int64_t>(segment.coded ? segment.coded->size() : 0);
  };
  Shares& poses = settings_.stream.memory->poses;
  const std::string& payer = stream.keys_.payer;
  const auto added = std::span(next.segments).subspan(before != nullptr ? before->segments.size() : 0);
  // Those of a memory that this one replaces are charged already.
  const auto is_new = [](const Generation::Segment& segment) { return segment.since == 0; };
  std::int64_t bytes = 0;
  for (const auto& segment : added) bytes += is_new(segment) ? bytes_of(segment) : 0;
  if (!poses.fits(payer, bytes, settings_.stream.max_memory_bytes))
    return too_many_poses(bytes, settings_.stream.max_memory_bytes);
  for (auto& segment : added) {
    if (is_new(segment)) {
      segment.poses = charged(segment.poses, settings_.stream.memory, payer, bytes_of(segment));
    }
    segment.since = number;
    if (auto grown = next.poses.add(segment.poses); !grown) return grown;
  }
  stream.set_memory(std::make_shared<const Generation>(std::move(next)));
  return {};
}

PosesCharge Hub::poses_charge(const std::string& holder) const {
  return [memory = settings_.stream.memory, holder, max = settings_.stream.max_memory_bytes](
             std::shared_ptr<const MemorySegment> segment) -> Result<std::shared_ptr<const MemorySegment>> {
    const std::int64_t bytes = memory_of(*segment);
    if (!memory->poses.fits(holder, bytes, max)) return too_many_poses(bytes, max);
    return charged(std::move(segment), memory, holder, bytes);
  };
}

void Hub::discharge(Stream& stream) {
  if (std::exchange(stream.charge_, nullptr)) --admitted_;
  stream.keys_ = {};
}

Stream* Hub::find(std::string_view name) {
  const auto found = streams_.find(name);
  return found == streams_.end() ? nullptr : found->second.get();
}

void Hub::unwatched(Stream& stream) {
  if (!stream.has_publisher() && stream.epoch() == 0) discharge(stream);
  if (is_idle(stream) && !stream.charge_) forget(streams_.find(stream.name()));
}

Result<std::unique_ptr<Stream>> Hub::make_apart(const std::string& name, const std::string& holder,
                                                const StreamFormat& format, TimeUs max_span_us) {
  Shares& keys = settings_.stream.memory->keys;
  const std::int64_t bytes = keys_bytes(format);
  if (!keys.fits(holder, bytes, settings_.stream.max_bytes))
    return fail(ErrorCode::kTooLarge, "its keys take up to " + std::to_string(bytes) +
                                          " bytes, and of limits.max_stream_bytes too few are free for one that holds "
                                          "more: try again later");
  static std::atomic<std::uint64_t> made{0};
  auto share = settings_.ids->of("~" + std::to_string(++made));  // No stream's name.
  if (!share) return share.error();
  Stream::Settings settings = settings_.stream;
  settings.taps.clear();
  settings.max_span_us = max_span_us;
  auto stream = std::make_unique<Stream>(name, std::move(*share), settings);
  stream->keys_ = {holder, bytes, keys.hold(holder, bytes)};
  return stream;
}

void Hub::forget_apart(Stream& stream) {
  assert(stream.watchers_here() == 0);
  leave_queues(stream);
}

void Hub::drop(Stream& stream) {
  assert(is_idle(stream));
  forget(streams_.find(stream.name()));
}

void Hub::pump(TimeUs now_us) {
  while (!wakeups_.empty() && wakeups_.begin()->first <= now_us) {
    Stream& stream = *wakeups_.begin()->second;
    unschedule(stream);
    stream.due_us_ = now_us;
    mark_dirty(stream);
  }
}

bool Hub::deliver(double slice_us) {
  double us = 0;
  for (const Stream* stream : dirty_) us += stream->delivery_us();
  const bool fits = late_.empty() && us <= slice_us;
  for (Stream* stream : dirty_) {
    if (fits) {
      deliver(*stream);
    } else if (late_streams_.try_emplace(stream->id(), stream).second) {
      const std::string& sender = stream->payer().empty() ? stream->name() : stream->payer();
      late_.push(sender, std::llround(stream->delivery_us()), stream->id());
    }
  }
  dirty_.clear();
  for (us = 0; !late_.empty() && us < slice_us;) {
    const auto next = late_.pop();
    const auto found = late_streams_.find(next.item);
    if (found == late_streams_.end()) continue;
    Stream& stream = *found->second;
    late_streams_.erase(found);
    us += static_cast<double>(next.cost);
    deliver(stream);
  }
  return !late_.empty();
}

void Hub::deliver(Stream& stream) {
  const auto due_us = std::exchange(stream.due_us_, std::nullopt);
  due_us ? stream.pump(*due_us) : stream.deliver();
  schedule(stream);
}

void Hub::forget(decltype(streams_)::iterator stream) {
  leave_queues(*stream->second);
  discharge(*stream->second);
  streams_.erase(stream);
}

void Hub::schedule(Stream& stream) {
  const auto due_us = stream.next_due_us();
  if (due_us == stream.wake_us_) return;
  unschedule(stream);
  if (!due_us) return;
  wakeups_.emplace(*due_us, &stream);
  stream.wake_us_ = due_us;
}

void Hub::leave_queues(Stream& stream) {
  std::erase(dirty_, &stream);
  late_streams_.erase(stream.id());
  unschedule(stream);
}

void Hub::unschedule(Stream& stream) {
  if (!stream.wake_us_) return;
  wakeups_.erase({*stream.wake_us_, &stream});
  stream.wake_us_.reset();
}

std::optional<TimeUs> Hub::next_due_us() const {
  if (wakeups_.empty()) return std::nullopt;
  return wakeups_.begin()->first;
}

std::vector<const Stream*> Hub::streams(std::string_view after, std::size_t most) const {
  std::vector<const Stream*> found;
  for (auto at = streams_.upper_bound(after); at != streams_.end() && found.size() < most; ++at)
    found.push_back(at->second.get());
  return found;
}

/// Removes a stream without publisher and watchers, one of the holder only if `own`; false: there is none.
bool Hub::make_room(const StreamHolder& holder, bool own) {
  std::map<std::string_view, std::size_t> held;
  std::vector<const Stream*> idle;
  for (const auto& [name, stream] : streams_) {
    if (!stream->charge_ || !is_idle(*stream)) continue;
    ++held[stream->holder_.key];
    const bool mine = stream->holder_.key == holder.key;
    if (own ? mine : !holder.stranger || stream->holder_.stranger) idle.push_back(stream.get());
  }
  // Strangers' go first, then the holder's own, those of the holder of most, and the oldest.
  const auto rank = [&](const Stream* stream) {
    return std::tuple(!stream->holder_.stranger, stream->holder_.key != holder.key,
                      -static_cast<std::int64_t>(held.at(stream->holder_.key)), stream->epoch());
  };
  const auto first =
      std::min_element(idle.begin(), idle.end(), [&](const Stream* a, const Stream* b) { return rank(a) < rank(b); });
  if (first == idle.end()) return false;
  forget(streams_.find((*first)->name()));
  return true;
}

/// Removes streams without publisher and watchers of those who have at least as much memory for keys as `payer` with
/// `bytes` more, of those with most first; false: all of them are not enough, and none was removed.
bool Hub::make_room_of_keys(const StreamHolder& holder, const std::string& payer, std::int64_t bytes) {
  const Shares& keys = settings_.stream.memory->keys;
  const std::int64_t most = keys.held(payer) + bytes;
  std::int64_t freed = 0;
  std::vector<std::pair<std::int64_t, const Stream*>> idle;
  for (const auto& [name, stream] : streams_) {
    if (!stream->charge_ || !is_idle(*stream) || (holder.stranger && !stream->holder_.stranger)) continue;
    const std::int64_t held = keys.held(stream->keys_.payer);
    if (stream->keys_.payer == payer || held < most) continue;
    freed += stream->keys_.bytes;
    idle.emplace_back(-held, stream.get());
  }
  const std::int64_t max = settings_.stream.max_bytes;
  if (!keys.fits(payer, bytes, max, freed)) return false;
  std::sort(idle.begin(), idle.end(), [](const auto& a, const auto& b) {
    return std::pair(a.first, a.second->epoch()) < std::pair(b.first, b.second->epoch());
  });
  for (const auto& [held, stream] : idle) {
    if (keys.fits(payer, bytes, max)) break;
    forget(streams_.find(stream->name()));
  }
  return keys.fits(payer, bytes, max);
}

}  // namespace eigencast::broker
