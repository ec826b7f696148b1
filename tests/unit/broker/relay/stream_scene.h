// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include "tests/unit/broker/support.h"

namespace eigencast::broker::testing {

/// A stream, its sender, and a clock.
class StreamTest : public ::testing::Test {
 protected:
  void begin() {
    ASSERT_TRUE(stream_.claim(sender_));
    ASSERT_TRUE(stream_.announce(small_announce(), ++epoch_));
    sender_.tag = stream_.tag();
  }

  /// Publishes `count` keys, each at its time, pumping every millisecond.
  void play(int count) {
    for (int i = 0; i < count; ++i) {
      ASSERT_TRUE(stream_.add_frame(sender_.next(now_), now_));
      wait(kInterval);
    }
  }
  void wait(TimeUs duration) {
    for (const TimeUs end = now_ + duration; now_ < end; now_ += 1000) stream_.pump(now_);
  }

  TimeUs now_ = 1'000'000;
  std::uint32_t epoch_ = 0;
  FakeSender sender_;
  Stream stream_{"a", 7, Stream::Settings{}};
};

}  // namespace eigencast::broker::testing
