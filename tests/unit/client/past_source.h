// SPDX-License-Identifier: MIT
#pragma once

#include <vector>

#include "tests/unit/view/fake_source.h"

namespace eigencast::testing {

inline constexpr TimeUs kBrokerUs = 1'800'000'000'000'000;  ///< On its clock, when ours is zero.
inline constexpr TimeUs kSecond = 1'000'000;

/// A stream, and a broker that keeps its last minute.
class PastSource final : public FakeSource, public Rewind {
 public:
  PastSource() : FakeSource(sphere_asset(1)) { info_->epoch = epoch_; }
  Rewind* rewind() override { return this; }
  std::optional<Kept> kept() const override { return kept_; }
  void ask_kept() override { ++asked; }
  void seek(TimeUs at_us, double speed, bool next) override { seeks.push_back({"demo", at_us, next, speed}); }
  void show_present() override { ++presents; }

  /// What the broker says to the newest seek.
  void answer(TimeUs at_us) {
    info_->epoch = epoch_ = ++past_epoch_;
    info_->rewind = control::StreamInfo::Rewind{at_us, 5'000, seeks.back().speed};
  }
  void go_live() {
    info_->epoch = epoch_ = 1;
    info_->rewind.reset();
  }

  std::optional<Kept> kept_ = Kept{kBrokerUs, 0, {{kBrokerUs - 60 * kSecond, kBrokerUs}}, "", 0};
  std::vector<control::Seek> seeks;
  int asked = 0, presents = 0;

 private:
  std::uint32_t past_epoch_ = 0x8000'0000;
};

}  // namespace eigencast::testing
