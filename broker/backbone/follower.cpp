// SPDX-License-Identifier: MIT
#include "broker/backbone/follower.h"

#include <numeric>
#include <utility>

namespace eigencast::broker {

bool Follower::is_of_epoch(ByteView message) const {
  ByteReader in(message);
  return in.u32() == epoch_ && !in.failed();
}

std::vector<Follower::Followed> Follower::take(Bytes message) {
  std::vector<Followed> out;
  ByteReader in(message);
  in.u32();
  const std::uint64_t sequence = in.u64();
  const auto frame = parse_frame(in.bytes(in.remaining()));
  if (!frame || !frame->envelope.is_key() || !is_of_epoch(message) || (newest_ && sequence <= *newest_)) {
    ++dropped_;
    return out;
  }
  Followed followed{sequence, std::move(message), *frame};
  if (frame->envelope.kind == FrameKind::kJoin) {
    joined_ = true;
    asked_us_.reset();
    newest_ = sequence;
    out.push_back(std::move(followed));
    // One that another broker forged must not hold back all to come.
    dropped_ += std::erase_if(kept_, [sequence](const Followed& kept) {
      return kept.sequence > sequence && kept.sequence - sequence > kMaxKept;
    });
    drain(out);
    return out;
  }
  if (!kept_.empty() && sequence <= kept_.back().sequence) {  // One publisher publishes in order.
    ++dropped_;
    return out;
  }
  kept_.push_back(std::move(followed));
  const auto bytes = [this] {
    return std::accumulate(kept_.begin(), kept_.end(), std::size_t{0},
                           [](std::size_t sum, const Followed& kept) { return sum + kept.message.size(); });
  };
  for (; kept_.size() > kMaxKept || bytes() > kMaxKeptBytes; ++dropped_) kept_.pop_front();
  if (joined_) drain(out);
  return out;
}

void Follower::drain(std::vector<Followed>& out) {
  while (!kept_.empty()) {
    if (kept_.front().sequence > *newest_ + 1) return restart();
    if (kept_.front().sequence == *newest_ + 1) {
      newest_ = kept_.front().sequence;
      out.push_back(std::move(kept_.front()));
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

void Follower::change_chain() {
  restart();
  kept_.clear();
}

}  // namespace eigencast::broker
