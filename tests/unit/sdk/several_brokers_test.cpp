// SPDX-License-Identifier: MIT
// Senders and viewers that know several brokers, one of which is lost.
#include <gtest/gtest.h>

#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

std::string url_of(const LoopbackBroker& a, const LoopbackBroker& b) {
  return "ws://127.0.0.1:" + std::to_string(a.port()) + ",127.0.0.1:" + std::to_string(b.port()) + "/live/ball";
}

/// Sends until a pose of what is sent from now on arrives, with the whole surface.
bool arrives(Sender& sender, Subscriber& subscriber) {
  TimeUs since_us = 0;
  return eventually([&] {
    if (sender.send() && since_us == 0) since_us = sender.sent.rbegin()->first;
    for (const ReceivedPose& pose : subscriber.poll(milliseconds(2))) {
      if (since_us != 0 && pose.envelope.capture_us >= since_us && subscriber.asset()->complete()) return true;
    }
    return false;
  });
}

TEST(SeveralBrokers, SenderAndViewerGoOnAtTheNext) {
  LoopbackBroker a, b;
  Sender sender(url_of(a, b), 40, CodecKind::kQuantised);
  auto subscriber = Subscriber::create({url_of(a, b), {}, {}});
  ASSERT_TRUE(subscriber) << subscriber.error().message;
  ASSERT_TRUE(arrives(sender, **subscriber));
  a.stop();
  ASSERT_TRUE(arrives(sender, **subscriber)) << sender.publisher->stats().detail;
  EXPECT_EQ(sender.publisher->stats().reconnects, 1u);
  EXPECT_NE(sender.publisher->stats().detail.find(std::to_string(b.port())), std::string::npos);
  a.start();
  b.stop();
  ASSERT_TRUE(arrives(sender, **subscriber)) << sender.publisher->stats().detail;
}

TEST(SeveralBrokers, SurfaceComesFromTheBrokerThatIsWatched) {
  LoopbackBroker a, b;
  Sender sender(b, 40);
  ASSERT_TRUE(sender.send_first());
  auto subscriber = Subscriber::create({url_of(a, b), {}, {}});
  ASSERT_TRUE(subscriber) << subscriber.error().message;
  ASSERT_TRUE(eventually([&] {
    (void)(*subscriber)->poll(milliseconds(2));
    return (*subscriber)->stats().state == Subscriber::State::kWaiting;
  })) << "nobody sends it at the first";
  a.stop();
  EXPECT_TRUE(arrives(sender, **subscriber));
}

TEST(SeveralBrokers, BrokerThatRefusesIsPassedOver) {
  LoopbackBroker a, b;
  Sender other(a, 40);
  ASSERT_TRUE(other.send_first());
  Sender sender(url_of(a, b), 40, CodecKind::kQuantised);
  EXPECT_TRUE(sender.send_first()) << sender.publisher->stats().detail;
  EXPECT_NE(sender.publisher->stats().detail.find(std::to_string(b.port())), std::string::npos);
}

}  // namespace
}  // namespace eigencast
