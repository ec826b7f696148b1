// SPDX-License-Identifier: MIT
#include "common/wire/envelope.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <map>
#include <memory>
#include <random>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

const FrameKind kKinds[] = {FrameKind::kKey, FrameKind::kJoin, FrameKind::kStep, FrameKind::kEstimate};
/// Keys 33,333 us apart.
const ChainClock kNewest{0x1112131415161718, 5'000'000, 33'333};

Envelope sample(FrameKind kind) {
  Envelope envelope;
  envelope.kind = kind;
  if (envelope.is_key()) envelope.bands = 0x0f;
  if (!envelope.is_key()) envelope.step = {2, 3};
  envelope.stream_id = 0x0304;
  envelope.tag = 0xa5;
  envelope.epoch = 7;
  envelope.sequence = kNewest.sequence + (kind == FrameKind::kKey ? 1 : 0);
  const TimeUs part = part_of(kNewest.age_us, {2, 3});
  envelope.capture_us = kind == FrameKind::kKey    ? kNewest.capture_us + kNewest.age_us
                        : kind == FrameKind::kJoin ? kNewest.capture_us
                        : kind == FrameKind::kStep ? kNewest.capture_us - kNewest.age_us + part
                                                   : kNewest.capture_us + part;
  if (envelope.is_key()) envelope.age_us = kNewest.age_us;
  return envelope;
}

Bytes frame_of(const Envelope& envelope, const Bytes& payload, const ChainClock& newest = kNewest) {
  Bytes frame;
  append_envelope(envelope, &newest, frame);
  frame.insert(frame.end(), payload.begin(), payload.end());
  return frame;
}

Bytes payload_of(const Envelope& envelope) {
  return envelope.bands.empty() ? Bytes{} : Bytes{9, 8, 7};
}

/// The frame from a heap block of exactly its size, so that a sanitizer sees any read beyond it.
Result<WireFrame> parsed(const Bytes& frame) {
  static std::unique_ptr<std::uint8_t[]> exact;
  exact.reset(new std::uint8_t[frame.size()]);
  std::copy(frame.begin(), frame.end(), exact.get());
  return parse_frame(ByteView(exact.get(), frame.size()));
}

TEST(Envelope, ProtocolDocumentsExamples) {
  Envelope step = sample(FrameKind::kStep);
  step.stream_id = 7;
  EXPECT_EQ(frame_of(step, {}), (Bytes{3, 7, 0xa5, 0x18, 0x23}));
  Envelope key = sample(FrameKind::kKey);
  key.stream_id = 7;
  key.flags = Envelope::kAhead;
  key.step = {1, 3};
  key.capture_us -= 100;
  EXPECT_EQ(frame_of(key, {}), (Bytes{9, 7, 0xa5, 0x19, 0x13, 0x0f, 0xc7, 0x01}));
  step.bands = 5;
  EXPECT_EQ(frame_of(step, {}), (Bytes{19, 7, 0xa5, 0x18, 0x23, 5}));
}

TEST(Envelope, EnvelopesAreShort) {
  std::mt19937_64 random(5);
  for (int i = 0; i < 10'000; ++i) {
    const std::uint32_t id = static_cast<std::uint32_t>(random() % 16'384);
    const ChainClock newest{random() % (1ULL << 35), static_cast<TimeUs>(random() % (1ULL << 56)) + 1'000'000,
                            static_cast<TimeUs>(random() % 1'000'000)};
    for (const FrameKind kind : kKinds) {
      Envelope envelope = sample(kind);
      envelope.stream_id = id;
      envelope.sequence = newest.sequence + (kind == FrameKind::kKey ? 1 : 0);
      envelope.capture_us = newest.capture_us + 1 + static_cast<TimeUs>(random() % 1'000'000);
      envelope.age_us = kind == FrameKind::kJoin ? newest.age_us : 0;
      const std::size_t most = kind == FrameKind::kJoin ? 22 : kind == FrameKind::kKey ? 9 : 6;
      EXPECT_LE(frame_of(envelope, {}, newest).size(), most) << static_cast<int>(kind);
    }
  }
  Envelope even = sample(FrameKind::kKey);
  even.stream_id = 127;
  EXPECT_EQ(frame_of(even, {}).size(), Envelope::kKeyBytes);
}

TEST(Envelope, EachKindRoundTrips) {
  std::mt19937_64 random(6);
  const auto below = [&random](std::uint64_t limit) { return static_cast<TimeUs>(random() % limit); };
  for (int i = 0; i < 20'000; ++i) {
    const int bits = static_cast<int>(1 + random() % 57);
    const TimeUs age = below(1ULL << bits);
    const ChainClock newest{random() >> (random() % 60) >> 2, age + below(1ULL << 57), age};
    Envelope envelope = sample(kKinds[random() % 4]);
    if (envelope.kind == FrameKind::kStep && random() % 2 == 0) envelope.bands = 0x0f;
    if (envelope.is_key() && random() % 2 == 0) {
      envelope.flags = Envelope::kAhead;
      const auto of = static_cast<std::uint8_t>(2 + random() % 14);
      if (random() % 2 == 0) envelope.step = {static_cast<std::uint8_t>(1 + random() % (of - 1)), of};
    }
    if (envelope.is_key() && random() % 2 == 0) envelope.flags |= Envelope::kRecalled;
    if (!envelope.is_key()) {
      envelope.step.of = static_cast<std::uint8_t>(1 + random() % 15);
      const bool beyond = envelope.kind == FrameKind::kEstimate;
      envelope.step.at = static_cast<std::uint8_t>(1 + random() % (beyond ? 15 : envelope.step.of));
    }
    envelope.stream_id = static_cast<std::uint32_t>(random());
    envelope.tag = static_cast<std::uint8_t>(random());
    envelope.sequence = newest.sequence + (envelope.kind == FrameKind::kKey ? 1 : 0);
    const TimeUs part = envelope.is_key() ? 0 : part_of(age, envelope.step);
    envelope.age_us = 0;
    switch (envelope.kind) {
      case FrameKind::kKey:
        envelope.age_us = 1 + below(1ULL << bits);
        envelope.capture_us = newest.capture_us + envelope.age_us;
        break;
      case FrameKind::kJoin:
        envelope.sequence = random();
        envelope.capture_us = below(1ULL << 62);
        envelope.age_us = below(static_cast<std::uint64_t>(envelope.capture_us) + 1);
        break;
      case FrameKind::kStep:
        envelope.capture_us = newest.capture_us - age + part;
        break;
      case FrameKind::kEstimate:
        envelope.capture_us = newest.capture_us + part;
        break;
    }
    const Bytes payload = payload_of(envelope), frame = frame_of(envelope, payload, newest);
    EXPECT_LE(frame.size(), Envelope::kMaxBytes + payload.size());
    const auto read = parsed(frame);
    ASSERT_TRUE(read) << read.error().message;
    const auto whole = resolved(*read, &newest, 7);
    ASSERT_TRUE(whole);
    EXPECT_EQ(whole->envelope, envelope);
    EXPECT_EQ(Bytes(whole->payload.begin(), whole->payload.end()), payload);
    if (envelope.kind != FrameKind::kJoin) {
      EXPECT_FALSE(resolved(*read, nullptr, 7));
    }
  }
}

TEST(Envelope, EveryTruncationIsRejected) {
  for (const FrameKind kind : kKinds) {
    const Bytes frame = frame_of(sample(kind), {});
    for (std::size_t size = 0; size < frame.size(); ++size) {
      const auto cut = parsed(Bytes(frame.begin(), frame.begin() + static_cast<std::ptrdiff_t>(size)));
      EXPECT_EQ(cut.error().code, ErrorCode::kCorrupt) << static_cast<int>(kind) << " " << size;
    }
  }
}

/// The frame with one byte of the envelope replaced.
Result<WireFrame> with_byte(FrameKind kind, std::size_t offset, std::uint8_t value) {
  Bytes frame = frame_of(sample(kind), payload_of(sample(kind)));
  frame[offset] = value;
  return parsed(frame);
}

TEST(Envelope, UnknownKindsAndReservedFlagsAreRejected) {
  for (const FrameKind kind : kKinds) {
    for (int flags = 0; flags < 32; ++flags) {
      const auto byte = static_cast<std::uint8_t>(static_cast<int>(kind) | flags << 3);
      // The byte of the bands serves as step, and the next one as bands.
      Bytes frame = frame_of(sample(kind), payload_of(sample(kind)));
      frame[0] = byte;
      if (flags == 1 || flags == 5) frame.insert(frame.begin() + (kind == FrameKind::kJoin ? 4 : 5), 0x13);
      if (flags == 2) frame.insert(frame.end(), {1, 9});
      const bool of_key = sample(kind).is_key() && (flags & ~(Envelope::kAhead | Envelope::kRecalled)) == 0;
      EXPECT_EQ(parsed(frame).has_value(), flags == 0 || of_key || (flags == 2 && kind == FrameKind::kStep))
          << int{byte};
    }
  }
  for (const int kind : {0, 5, 6, 7}) EXPECT_FALSE(with_byte(FrameKind::kKey, 0, static_cast<std::uint8_t>(kind)));
}

TEST(Envelope, StepMustSuitTheKind) {
  for (int step = 0; step < 256; ++step) {
    const auto byte = static_cast<std::uint8_t>(step);
    const bool beyond = (step >> 4) >= 1 && (step & 15) >= 1, between = beyond && (step >> 4) <= (step & 15);
    EXPECT_EQ(with_byte(FrameKind::kStep, 5, byte).has_value(), between) << step;
    EXPECT_EQ(with_byte(FrameKind::kEstimate, 5, byte).has_value(), beyond) << step;
    Envelope key = sample(FrameKind::kKey);
    key.flags = Envelope::kAhead;
    Bytes frame = frame_of(key, payload_of(key));
    frame[5] = byte;
    EXPECT_EQ(parsed(frame).has_value(), step == 0 || (between && (step >> 4) < (step & 15))) << step;
  }
}

TEST(Envelope, BandsAndPayloadBelongTogether) {
  EXPECT_FALSE(with_byte(FrameKind::kKey, 5, 0));
  Envelope residual = sample(FrameKind::kStep);
  residual.bands = 1;
  EXPECT_TRUE(parsed(frame_of(residual, {0})));
  EXPECT_FALSE(parsed(frame_of(residual, {})));
  EXPECT_FALSE(parsed(frame_of(sample(FrameKind::kKey), {})));
  for (const Envelope& bare : {sample(FrameKind::kStep), sample(FrameKind::kEstimate)}) {
    EXPECT_TRUE(parsed(frame_of(bare, {})));
    EXPECT_FALSE(parsed(frame_of(bare, {0})));
  }
}

TEST(Envelope, LimitsOfSizeAndTime) {
  Envelope join = sample(FrameKind::kJoin);
  join.capture_us = limits::kMaxTimeUs;
  join.age_us = join.capture_us;
  EXPECT_TRUE(parsed(frame_of(join, {1})));
  join.age_us = join.capture_us + 1;
  EXPECT_FALSE(parsed(frame_of(join, {1}))) << "the older key before time began";
  join.age_us = 0;
  ++join.capture_us;
  EXPECT_FALSE(parsed(frame_of(join, {1})));
  Bytes frame = frame_of(sample(FrameKind::kKey), {});
  frame.resize(limits::kMaxFrameBytes);
  EXPECT_TRUE(parse_frame(frame));
  frame.push_back(0);
  EXPECT_EQ(parse_frame(frame).error().code, ErrorCode::kTooLarge);
}

TEST(Envelope, TimesBeyondTheRangeAreNotResolved) {
  const TimeUs max = limits::kMaxTimeUs;
  for (const ChainClock& newest : {ChainClock{5, max, max}, ChainClock{5, max, 1}, ChainClock{5, max, max / 16}}) {
    for (const FrameKind kind : {FrameKind::kKey, FrameKind::kEstimate}) {
      WireFrame frame;
      frame.envelope.kind = kind;
      frame.check = kind == FrameKind::kEstimate ? 5 : 6;
      frame.envelope.step = kind == FrameKind::kKey ? InterpolationStep{} : InterpolationStep{15, 15};
      frame.delay_us = max;
      EXPECT_FALSE(resolved(frame, &newest, 0));
      if (kind == FrameKind::kEstimate) frame.envelope.step = {15, 1};
      frame.delay_us = kind == FrameKind::kEstimate ? 0 : -max;
      const auto low = resolved(frame, &newest, 0);
      EXPECT_TRUE(!low || (low->envelope.capture_us >= 0 && low->envelope.capture_us <= max));
    }
  }
  WireFrame beyond;
  beyond.envelope.kind = FrameKind::kEstimate;
  beyond.check = 5;
  beyond.envelope.step = {15, 14};
  const ChainClock old{5, max, max / 15 * 14 + 13};
  EXPECT_FALSE(resolved(beyond, &old, 0)) << "the sum takes more than 63 bits";
  WireFrame next;
  next.check = 0;
  next.delay_us = 1;
  const ChainClock last{~std::uint64_t{0}, 0, 0};
  EXPECT_FALSE(resolved(next, &last, 0)) << "sequences do not wrap";
  next.check = 8;
  next.delay_us = 0;
  const ChainClock still{7, 100, 0};
  EXPECT_FALSE(resolved(next, &still, 0)) << "the capture time must grow";
}

/// A broker that sends one viewer keys, joins, steps and poses in between, of one epoch after the other, on ids that
/// are used again. Its clock steps; gaps of keys are followed by a join, or by mistake by another frame.
class History {
 public:
  explicit History(unsigned seed) : random_(seed) {}

  struct Sent {
    Envelope envelope;
    Bytes message;
    bool stream = false;  ///< A `stream` message: the epoch of `envelope` begins.
  };

  Sent next() {
    const unsigned choice = below(40);
    if (!begun_ || choice == 0) return begin();
    if (choice == 1) now_us_ += static_cast<TimeUs>(random_() % 2 == 0 ? random_() % 10'000'000'000 : 0);
    if (choice == 2 && newest_ && !gap_) {  // Keys that the viewer does not get.
      const unsigned lost = 1 + below(255);
      for (unsigned i = 0; i < lost; ++i) (void)key();
      gap_ = true;
    }
    const bool may_err = gap_ && choice % 2 == 0;  // It forgets that it has to send a join.
    if (!newest_ || choice == 3 || (gap_ && !may_err)) return join();
    if (choice < 20) return key();
    return made();
  }

 private:
  unsigned below(unsigned limit) { return static_cast<unsigned>(random_() % limit); }
  Sent begin() {
    ++epoch_;
    const std::uint32_t id = below(3) + 1;
    envelope_ = {};
    envelope_.stream_id = id;
    envelope_.tag = ++tags_[id];
    envelope_.epoch = epoch_;
    newest_.reset();
    now_us_ = static_cast<TimeUs>(random_() % 1'000'000);  // Another sender's clock.
    sequence_ = random_() % 2 == 0 ? 0 : random_() % 1000;
    begun_ = true;
    gap_ = false;
    return {envelope_, {}, true};
  }
  Sent frame(Envelope envelope) {
    Bytes message;
    append_envelope(envelope, newest_ ? &*newest_ : nullptr, message);
    if (!envelope.bands.empty()) message.push_back(0);
    return {envelope, message, false};
  }
  Envelope head(FrameKind kind) {
    Envelope out = envelope_;
    out.kind = kind;
    out.bands = kind == FrameKind::kEstimate ? 0 : 1;
    out.sequence = sequence_;
    out.capture_us = now_us_;
    return out;
  }
  void advance() {
    ++sequence_;
    now_us_ += 1 + static_cast<TimeUs>(random_() % (random_() % 8 == 0 ? 3'000'000 : 40'000));
  }
  Sent join() {
    if (!newest_ || random_() % 2 == 0) advance();
    Envelope out = head(FrameKind::kJoin);
    out.age_us = static_cast<TimeUs>(random_() % 2 == 0 ? 0 : random_() % std::min<TimeUs>(now_us_ + 1, 100'000));
    const Sent sent = frame(out);
    newest_ = ChainClock::after(out);
    gap_ = false;
    return sent;
  }
  Sent key() {
    advance();
    Envelope out = head(FrameKind::kKey);
    out.age_us = now_us_ - newest_->capture_us;
    if (random_() % 2 == 0) {
      out.flags = Envelope::kAhead;
      out.step = {1, 3};
    }
    const Sent sent = frame(out);
    newest_ = ChainClock::after(out);
    return sent;
  }
  Sent made() {
    const FrameKind kind = random_() % 2 == 0 ? FrameKind::kStep : FrameKind::kEstimate;
    Envelope out = head(kind);
    if (random_() % 2 == 0) out.bands = 0;
    out.step = {static_cast<std::uint8_t>(1 + random_() % 3), 3};
    const TimeUs part = part_of(newest_->age_us, out.step);
    out.sequence = newest_->sequence;
    out.capture_us = newest_->capture_us + part - (kind == FrameKind::kStep ? newest_->age_us : 0);
    return frame(out);
  }

  std::mt19937 random_;
  std::map<std::uint32_t, std::uint8_t> tags_;
  Envelope envelope_;
  std::uint32_t epoch_ = 0;
  std::optional<ChainClock> newest_;
  std::uint64_t sequence_ = 0;
  TimeUs now_us_ = 0;
  bool begun_ = false, gap_ = false;
};

TEST(EnvelopeReader, FrameIsReadExactlyOrRefused) {
  std::size_t exact = 0, refused = 0, late = 0;
  for (unsigned seed = 0; seed < 60; ++seed) {
    History history(seed);
    std::mt19937 random(seed + 1000);
    EnvelopeReader reader;
    std::deque<History::Sent> before;  // Of earlier epochs, to come once more.
    std::uint32_t epoch = 0;
    for (int i = 0; i < 1500; ++i) {
      const History::Sent sent = history.next();
      if (sent.stream) {
        reader.begin(sent.envelope.stream_id, sent.envelope.tag, sent.envelope.epoch);
        epoch = sent.envelope.epoch;
        continue;
      }
      const auto frame = parse_frame(sent.message);
      ASSERT_TRUE(frame) << frame.error().message;
      const auto read = reader.read(*frame);
      read ? ++exact : ++refused;
      if (read) {
        ASSERT_EQ(read->envelope, sent.envelope) << "seed " << seed << ", " << i;
      }
      before.push_back(sent);
      if (before.size() > 600) before.pop_front();
      if (random() % 10 == 0) {
        const History::Sent& again = before[random() % before.size()];
        if (again.envelope.epoch == epoch) continue;
        ++late;
        ASSERT_FALSE(reader.read(*parse_frame(again.message))) << "of an epoch that is over";
      }
    }
  }
  EXPECT_GT(exact, 30'000U);
  EXPECT_GT(refused, 1'000U);
  EXPECT_GT(late, 1'000U);
}

TEST(EnvelopeReader, GapIsBridgedByAJoinOnly) {
  const auto message = [](FrameKind kind, std::uint64_t sequence) {
    Envelope envelope;
    envelope.kind = kind;
    envelope.bands = 1;
    envelope.sequence = sequence;
    envelope.capture_us = static_cast<TimeUs>(sequence) * 1000;
    const ChainClock newest{sequence - 1, envelope.capture_us - 1000, 0};
    return frame_of(envelope, {0}, newest);
  };
  for (std::uint64_t lost = 1; lost < 256; ++lost) {
    EnvelopeReader reader;
    ASSERT_TRUE(reader.read(*parse_frame(message(FrameKind::kJoin, 300))));
    EXPECT_FALSE(reader.read(*parse_frame(message(FrameKind::kKey, 301 + lost)))) << lost;
    EXPECT_FALSE(reader.read(*parse_frame(message(FrameKind::kKey, 301)))) << "not even the right one";
    EXPECT_TRUE(reader.read(*parse_frame(message(FrameKind::kJoin, 301 + lost))));
  }
}

}  // namespace
}  // namespace eigencast
