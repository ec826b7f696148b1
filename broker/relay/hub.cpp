// SPDX-License-Identifier: MIT
#include "broker/relay/hub.h"

#include <cassert>

namespace eigencast::broker {
namespace {

bool is_idle(const Stream& stream) {
  return !stream.has_publisher() && stream.watchers_here() == 0 && !stream.is_mirrored();
}

}  // namespace

Result<Stream*> Hub::open(std::string_view name) {
  if (Stream* stream = find(name)) return stream;
  if (streams_.size() >= settings_.max_streams && !make_room()) {
    return fail(ErrorCode::kTooLarge, "all " + std::to_string(settings_.max_streams) +
                                          " streams that limits.max_streams allows are in use: raise it, or stop one");
  }
  auto made = std::make_unique<Stream>(std::string(name), settings_.ids->of(name), settings_.stream);
  Stream* stream = streams_.emplace(std::string(name), std::move(made)).first->second.get();
  if (settings_.on_opened) settings_.on_opened(*stream);
  return stream;
}

Stream* Hub::find(std::string_view name) {
  const auto found = streams_.find(name);
  return found == streams_.end() ? nullptr : found->second.get();
}

void Hub::unwatched(Stream& stream) {
  if (is_idle(stream) && stream.epoch() == 0) forget(streams_.find(stream.name()));
}

void Hub::drop(Stream& stream) {
  assert(is_idle(stream));
  forget(streams_.find(stream.name()));
}

void Hub::pump(TimeUs now_us) {
  pumping_.clear();
  for (const auto& [due_us, stream] : wakeups_) {
    if (due_us > now_us) break;
    pumping_.push_back(stream);
  }
  for (Stream* stream : pumping_) {
    stream->pump(now_us);
    schedule(*stream);
  }
}

void Hub::mark_dirty(Stream& stream) {
  if (dirty_.empty() || dirty_.back() != &stream) dirty_.push_back(&stream);
}

void Hub::deliver() {
  for (Stream* stream : dirty_) {
    stream->deliver();
    schedule(*stream);
  }
  delivered_.swap(dirty_);
  dirty_.clear();
}

void Hub::prepare() {
  for (Stream* stream : delivered_) stream->prepare();
  delivered_.clear();
}

void Hub::forget(decltype(streams_)::iterator stream) {
  std::erase(dirty_, stream->second.get());
  std::erase(delivered_, stream->second.get());
  unschedule(*stream->second);
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

void Hub::unschedule(Stream& stream) {
  if (!stream.wake_us_) return;
  wakeups_.erase({*stream.wake_us_, &stream});
  stream.wake_us_.reset();
}

std::optional<TimeUs> Hub::next_due_us() const {
  if (wakeups_.empty()) return std::nullopt;
  return wakeups_.begin()->first;
}

std::vector<const Stream*> Hub::streams() const {
  std::vector<const Stream*> all;
  all.reserve(streams_.size());
  for (const auto& [name, stream] : streams_) all.push_back(stream.get());
  return all;
}

bool Hub::make_room() {
  // The idle stream with the oldest epoch.
  auto oldest = streams_.end();
  for (auto it = streams_.begin(); it != streams_.end(); ++it) {
    if (is_idle(*it->second) && (oldest == streams_.end() || it->second->epoch() < oldest->second->epoch()))
      oldest = it;
  }
  if (oldest == streams_.end()) return false;
  forget(oldest);
  return true;
}

}  // namespace eigencast::broker
