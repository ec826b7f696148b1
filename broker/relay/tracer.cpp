// SPDX-License-Identifier: MIT
#include "broker/relay/tracer.h"

namespace eigencast::broker {
namespace {

// More than any feed holds back.
constexpr std::size_t kMaxArrivals = 16;

}  // namespace

void Tracer::want(Watcher& who, std::uint32_t every) {
  const auto known = wanted_.find(&who);
  if (known != wanted_.end()) {
    intervals_.erase(intervals_.find(known->second));
    wanted_.erase(known);
  }
  if (every == 0) return;
  wanted_.emplace(&who, every);
  intervals_.insert(every);
}

std::vector<Watcher*> Tracer::who_wants(std::uint64_t sequence) const {
  std::vector<Watcher*> all;
  for (const auto& [who, every] : wanted_) {
    if (sequence % every == 0) all.push_back(who);
  }
  return all;
}

void Tracer::note_key(std::uint64_t sequence, TimeUs arrival_us) {
  if (intervals_.empty()) return arrivals_.clear();
  arrivals_.push_back({sequence, arrival_us});
  if (arrivals_.size() > kMaxArrivals) arrivals_.pop_front();
}

std::optional<control::Trace> Tracer::trace_of(const Frame& frame) const {
  const Envelope& head = frame.envelope;
  const auto arrival =
      std::find_if(arrivals_.begin(), arrivals_.end(), [&](const Arrival& a) { return a.sequence == head.sequence; });
  if (arrival == arrivals_.end() || frame.times.written_us == 0 || !is_traced(head.sequence)) return std::nullopt;
  control::Trace trace;
  trace.stream_id = head.stream_id;
  trace.epoch = head.epoch;
  trace.sequence = head.sequence;
  trace.step = head.step.byte();
  trace.stages.emplace_back(control::stage::kArrived, arrival->arrival_us);
  if (frame.times.due_us != 0) trace.stages.emplace_back(control::stage::kScheduled, frame.times.due_us);
  trace.stages.emplace_back(control::stage::kWritten, frame.times.written_us);
  return trace;
}

}  // namespace eigencast::broker
