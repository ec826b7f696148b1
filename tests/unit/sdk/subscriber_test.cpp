// SPDX-License-Identifier: MIT
// Publisher and subscriber against a broker that says what a real one seldom does.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/core/clock.h"
#include "common/surface/shapes/shapes.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sdk/subscriber.h"
#include "tests/support/process.h"
#include "tests/unit/sdk/scripted_broker.h"

namespace eigencast {
namespace {

using testing::eventually;
using ::testing::HasSubstr;
using testing::milliseconds;

const std::string kWaiting = R"({"op":"stream","stream":"live/ball","state":"waiting","stream_id":7,"epoch":0})";
const std::string kDeclined = R"({"op":"error","code":"refused","message":"no room","stream":"live/ball"})";
const std::string kBye = R"({"op":"bye","reason":"upgrade","retry_after_ms":60000})";

/// The pause that a text announces; -1 if it announces none.
long next_try_ms(const std::string& detail) {
  const std::string words = "next try in ";
  const auto at = detail.find(words);
  if (at == std::string::npos) return -1;
  const std::string wait = detail.substr(at + words.size());
  return std::lround(std::stod(wait) * (wait.find(" ms") == std::string::npos ? 1000 : 1));
}

std::unique_ptr<Subscriber> subscribe(const ScriptedBroker& broker) {
  SubscriberOptions options;
  options.url = broker.url();
  options.declined_retry = milliseconds(100);
  auto made = Subscriber::create(std::move(options));
  EXPECT_TRUE(made) << made.error().message;
  return std::move(*made);
}

TEST(Subscriber, RefusedStreamIsRequestedAgain) {
  ScriptedBroker broker({{kWaiting, kDeclined}, [](const auto&) { return kWaiting; }});
  const TimeUs start_us = steady_now_us();
  const auto subscriber = subscribe(broker);
  bool refused = false;
  ASSERT_TRUE(eventually([&] {
    (void)subscriber->poll(milliseconds(1));
    const auto stats = subscriber->stats();
    if (stats.state == Subscriber::State::kRefused) {
      refused = true;
      const bool had_info = subscriber->info().has_value();
      EXPECT_TRUE(!had_info || subscriber->stats().state != Subscriber::State::kRefused);
      EXPECT_THAT(stats.detail, HasSubstr("no room"));
      EXPECT_LE(stats.retry_in.value_or(-1), 100'000);
      EXPECT_GE(stats.retry_in.value_or(-1), 0);
      EXPECT_GE(steady_now_us() + stats.retry_in.value_or(-1), start_us + 100'000);
    }
    return broker.received<control::Subscribe>().size() == 1 && stats.state == Subscriber::State::kWaiting;
  }));
  EXPECT_TRUE(refused);
  EXPECT_TRUE(subscriber->info());
}

TEST(Subscriber, ByeDelaysTheReconnect) {
  ScriptedBroker broker({{kWaiting, kBye}, {}, true});
  const TimeUs start_us = steady_now_us();
  const auto subscriber = subscribe(broker);
  ASSERT_TRUE(eventually(
      [&] { return (void)subscriber->poll(milliseconds(1)), subscriber->stats().state == Subscriber::State::kLost; }));
  const TimeUs retry_in_us = subscriber->stats().retry_in.value_or(0);
  EXPECT_GE(steady_now_us() + retry_in_us, start_us + 60'000'000);
}

TEST(Publisher, ByeDelaysTheReconnect) {
  auto baked = bake(make_icosphere(1), {.basis = BasisKind::kAugmented, .rank = 8, .name = "ball"});
  ASSERT_TRUE(baked) << baked.error().message;
  ScriptedBroker broker({{kBye}, {}, true});
  PublisherOptions options;
  options.url = broker.url();
  auto publisher = Publisher::create(options, std::make_shared<const Asset>(std::move(baked->asset)),
                                     std::make_shared<const EncodedAsset>(std::move(baked->encoded)));
  ASSERT_TRUE(publisher) << publisher.error().message;
  EXPECT_TRUE(eventually([&] { return next_try_ms((*publisher)->stats().detail) >= 60000; }))
      << (*publisher)->stats().detail;
}

}  // namespace
}  // namespace eigencast
