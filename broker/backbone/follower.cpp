// SPDX-License-Identifier: MIT
#include "broker/backbone/follower.h"

#include <numeric>
#include <utility>

#include "common/wire/envelope.h"

namespace eigencast::broker {

std::vector<Bytes> Follower::take(Bytes message) {
  std::vector<Bytes> out;
  const auto frame = parse_frame(message);
  const bool usable = frame && frame->envelope.epoch == epoch_ &&
                      (frame->envelope.kind == FrameKind::kKey || frame->envelope.kind == FrameKind::kJoin) &&
                      (!newest_ || frame->envelope.sequence > *newest_);
  if (!usable) {
    ++dropped_;
    return out;
  }
  const std::uint64_t sequence = frame->envelope.sequence;
  if (frame->envelope.kind == FrameKind::kJoin) {
    joined_ = true;
    asked_us_.reset();
    newest_ = sequence;
    out.push_back(std::move(message));
    drain(out);
    return out;
  }
  if (!kept_.empty() && sequence <= kept_.back().sequence) {  // One publisher publishes in order.
    ++dropped_;
    return out;
  }
  kept_.push_back({sequence, std::move(message)});
  const auto bytes = [this] {
    return std::accumulate(kept_.begin(), kept_.end(), std::size_t{0},
                           [](std::size_t sum, const Kept& kept) { return sum + kept.message.size(); });
  };
  for (; kept_.size() > kMaxKept || bytes() > kMaxKeptBytes; ++dropped_) kept_.pop_front();
  if (joined_) drain(out);
  return out;
}

void Follower::drain(std::vector<Bytes>& out) {
  while (!kept_.empty()) {
    if (kept_.front().sequence > *newest_ + 1) return restart();
    if (kept_.front().sequence == *newest_ + 1) {
      newest_ = kept_.front().sequence;
      out.push_back(std::move(kept_.front().message));
    }
    kept_.pop_front();
  }
}

bool Follower::wants_join(TimeUs now_us) {
  if (joined_ || (asked_us_ && now_us - *asked_us_ < kJoinTimeoutUs)) return false;
  asked_us_ = now_us;
  return true;
}

void Follower::restart() {
  joined_ = false;
  asked_us_.reset();
}

}  // namespace eigencast::broker
