// SPDX-License-Identifier: MIT
// A memory of poses from a sender through a whole broker to viewers.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/codec/chain.h"
#include "sdk/key_writer.h"
#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

constexpr int kLoop = 60;

template <typename Condition>
bool in_time(Condition condition) {
  return eventually(condition, milliseconds(60'000));
}

/// Sends a motion that comes again.
class LoopSender : public Sender {
 public:
  explicit LoopSender(const LoopbackBroker& broker) : Sender(broker, 40, CodecKind::kQuantised) {}

  bool send_pose(int i) {
    const TimeUs now = steady_now_us();
    if (now <= sent_us_) return false;
    const auto C = pose(*model(40).asset, 7 * (i % kLoop));
    if (publisher->send_coefficients(C, now) != SendStatus::kSent) return false;
    sent_us_ = now;
    received[now] = publisher->as_received();
    return true;
  }
  /// Poses first .. first + count - 1 of the loop.
  static CodedSegment segment(int first, int count) {
    const Model& m = model(40);
    const CoefficientLayout layout{CodecKind::kQuantised, m.asset->rank, 3, m.asset->band_ends};
    std::vector<Key> keys;
    for (int i = first; i < first + count; ++i)
      keys.push_back(key_from_coefficients(layout, pose(*m.asset, 7 * i), step_index_below(1e-4)).value());
    return encode_segment(layout, m.encoded->manifest.id.digest, keys, 3).value();
  }
  bool holds(std::uint32_t generation) const {
    const auto memory = publisher->memory();
    return !memory.pending && memory.generation >= generation;
  }

 private:
  TimeUs sent_us_ = 0;
};

/// What the sender says that receivers decode: to the bit in keys of its memory, else maybe coded anew by the broker.
void expect_sent(const Coefficients& got, const std::vector<double>& sent, bool exact) {
  ASSERT_EQ(got.size(), sent.size());
  double most = 0;
  for (std::size_t i = 0; i < sent.size(); ++i) most = std::max(most, std::abs(got[i] - sent[i]));
  EXPECT_LE(most, exact ? 0 : 0.03);
}

int check(const LoopSender& sender, Subscriber& viewer, int& recalled) {
  int poses = 0;
  for (const ReceivedPose& p : viewer.poll(milliseconds(1))) {
    const auto sent = sender.received.find(p.envelope.capture_us);
    if (p.envelope.kind == FrameKind::kStep || sent == sender.received.end()) continue;
    expect_sent(p.coefficients, sent->second, p.envelope.is_recalled());
    recalled += p.envelope.is_recalled() ? 1 : 0;
    ++poses;
  }
  return poses;
}

/// As a recording is played again: over another chain, which holds the memory from a later key on.
TEST(KeyWriter, KeysOfAMemoryAreSentAgainAsTheyWere) {
  const CoefficientLayout layout{CodecKind::kQuantised, 6, 3, {2, 6}};
  const auto key_at = [&](int i) {
    Key key = empty_key(layout, layout.all_bands(), 120);
    for (std::size_t v = 0; v < key.q.size(); ++v)
      key.q[v] = static_cast<std::int32_t>(std::lround(900 * std::sin(0.2 * i + static_cast<double>(v))));
    return key;
  };
  std::vector<Key> poses;
  for (int i = 0; i < 30; ++i) poses.push_back(key_at(i));
  PoseMemory memory(layout);
  ASSERT_TRUE(memory.add(encode_segment(layout, {}, poses, 2).value().segment));
  KeyWriter again(layout, 0, std::nullopt);
  again.begin(control::Announced{"s", 1, 1, 1, {}});
  auto state = advanced(std::nullopt, key_at(0), 0);
  int as_it_was = 0;
  for (int i = 1; i < 29; ++i) {
    const auto coded =
        encode_recalled_key(layout, state, memory, static_cast<std::uint32_t>(8 * i), key_at(i), 4).value();
    state = advanced(std::move(state), coded.key, 33'000, coded.phase);
    if (i == 10) again.code_by({}, memory, false);
    auto sent = again.code_as(coded.key, coded.payload, coded.phase, 33'000 * i).value();
    EXPECT_EQ(sent.next.newer, coded.key) << i;
    EXPECT_EQ(sent.next.phase.has_value(), i >= 10) << i;
    const ByteView payload = coded.payload, message = sent.message;
    const bool same = message.size() > payload.size() && std::ranges::equal(message.last(payload.size()), payload);
    EXPECT_EQ(same, i > 10) << i;
    as_it_was += same ? 1 : 0;
    again.sent(std::move(sent), 1);
  }
  EXPECT_EQ(as_it_was, 18);
}

TEST(Memory, KeysComeFromItOnceBrokerAndViewersHoldIt) {
  LoopbackBroker broker;
  LoopSender sender(broker);
  const auto viewer = subscribe(broker);
  int n = 0, recalled = 0, late_recalled = 0;
  ASSERT_TRUE(in_time([&] { return sender.send_pose(n); }));
  ASSERT_TRUE(
      sender.publisher->remember({LoopSender::segment(0, kLoop / 2), LoopSender::segment(kLoop / 2, kLoop / 2)}));
  ASSERT_TRUE(in_time([&] {
    n += sender.send_pose(n + 1) ? 1 : 0;
    check(sender, *viewer, recalled);
    return recalled >= 100;
  })) << sender.publisher->memory().pending;
  EXPECT_TRUE(sender.holds(1));
  EXPECT_GT(sender.publisher->stats().frames_recalled, 100U);
  // One that comes later gets a plain chain, fetches, and changes over.
  const auto late = subscribe(broker, {.rate = Profile::Rate::kInterpolated, .k = 3});
  bool plain = false;
  ASSERT_TRUE(in_time([&] {
    n += sender.send_pose(n + 1) ? 1 : 0;
    check(sender, *viewer, recalled);
    for (const ReceivedPose& p : late->poll(milliseconds(1))) {
      plain = plain || !p.envelope.is_recalled();
      if (p.next) {
        const auto sent = sender.received.find(p.next->capture_us);
        late_recalled += sent != sender.received.end() && p.next->coefficients == Coefficients(sent->second);
      }
    }
    return late_recalled >= 50;
  }));
  EXPECT_TRUE(plain);
  EXPECT_EQ(viewer->stats().rejected, 0U);
  EXPECT_EQ(late->stats().rejected, 0U);
  // It grows, and is replaced, and is given up, while frames go on.
  for (const std::vector<CodedSegment>& next :
       {std::vector{LoopSender::segment(0, kLoop / 2), LoopSender::segment(kLoop / 2, kLoop / 2),
                    LoopSender::segment(3, 20)},
        std::vector{LoopSender::segment(5, 40)}, std::vector<CodedSegment>{}}) {
    const auto before = sender.publisher->memory().generation;
    ASSERT_TRUE(sender.publisher->remember(next));
    const std::uint64_t frames = sender.publisher->stats().frames_sent;
    const int until = recalled + 100;
    ASSERT_TRUE(in_time([&] {
      n += sender.send_pose(n + 1) ? 1 : 0;
      check(sender, *viewer, recalled);
      const bool taken = next.empty() ? sender.publisher->memory().generation == 0 : sender.holds(before + 1);
      return taken && sender.publisher->stats().frames_sent > frames + 100 && (next.empty() || recalled >= until);
    }));
    EXPECT_FALSE(sender.publisher->memory().refused);
  }
  EXPECT_EQ(viewer->stats().rejected, 0U);
}

TEST(Memory, OutlivesTheBroker) {
  LoopbackBroker broker;
  LoopSender sender(broker);
  const auto viewer = subscribe(broker);
  int n = 0, recalled = 0;
  ASSERT_TRUE(sender.publisher->remember({LoopSender::segment(0, kLoop)})) << "before it is connected";
  const auto many = [&](int more) {
    const int until = recalled + more;
    return in_time([&] {
      n += sender.send_pose(n + 1) ? 1 : 0;
      check(sender, *viewer, recalled);
      return recalled >= until;
    });
  };
  ASSERT_TRUE(many(30));
  broker.stop();
  ASSERT_TRUE(in_time([&] { return sender.publisher->memory().generation == 0; }));
  broker.forget_assets();
  broker.start();
  ASSERT_TRUE(many(30)) << "uploaded again";
}

}  // namespace
}  // namespace eigencast
