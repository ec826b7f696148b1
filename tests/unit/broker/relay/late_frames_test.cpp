// SPDX-License-Identifier: MIT
//
// Whatever streams, senders, viewers and links do, a viewer takes no frame for another.
#include <gtest/gtest.h>

#include <array>
#include <deque>
#include <random>

#include "broker/relay/hub.h"
#include "broker/relay/outbox.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

using namespace testing;

constexpr std::array kStreamNames{"a", "b", "c", "d"};

/// One message on its way to the viewer.
struct OnItsWay {
  std::optional<control::StreamInfo> info;
  FramePtr frame;
  std::string stream;  ///< Of the frame.
};

/// A viewer's connection in the broker, and the viewer behind a slow link.
class LateViewer final : public Watcher {
 public:
  explicit LateViewer(Hub& hub) : hub_(hub) {}

  void on_stream_changed(const Stream& stream, bool restart) override {
    if (restart) outbox_.open_lane(stream.id());
    link_.push_back({stream.info_for(*this), nullptr, {}});
  }
  void on_frames(const Stream& stream, std::span<const FramePtr> frames) override {
    for (const FramePtr& frame : frames) outbox_.offer(stream.id(), frame);
  }
  void on_trace(const std::shared_ptr<const std::string>&) override {}

  void subscribe(const std::string& name, const Profile& profile) {
    wanted_[name];
    ASSERT_TRUE(hub_.open(name).value()->watch(*this, profile));
  }
  void unsubscribe(const std::string& name) {
    Stream* stream = hub_.find(name);
    if (wanted_.erase(name) == 0) return;
    outbox_.close_lane(stream->id());
    stream->unwatch(*this);
    hub_.unwatched(*stream);
  }
  /// The broker writes what the socket takes.
  void write(std::size_t most, TimeUs now_us) {
    const auto join_of = [this](std::uint32_t id) -> FramePtr {
      for (const Stream* stream : hub_.streams())
        if (stream->id() == id) return hub_.find(stream->name())->join_for(*this);
      return nullptr;
    };
    for (; most > 0; --most) {
      auto item = outbox_.take(now_us, join_of);
      if (!item) return;
      std::string name;
      for (const Stream* stream : hub_.streams())
        if (stream->id() == item->frame->envelope.stream_id) name = stream->name();
      link_.push_back({std::nullopt, item->frame, name});
    }
  }
  /// The viewer reads.
  void read(std::size_t most) {
    for (; most > 0 && !link_.empty(); --most) {
      const OnItsWay message = std::move(link_.front());
      link_.pop_front();
      message.info ? note(*message.info) : take(message);
    }
  }

  std::size_t exact = 0, refused = 0;

 private:
  struct Seen {
    std::optional<std::uint32_t> id;
    EnvelopeReader reader;
  };
  void note(const control::StreamInfo& info) {
    const auto found = wanted_.find(info.stream);
    if (found == wanted_.end()) return;
    found->second.id = info.stream_id;
    found->second.reader.begin(info.stream_id, info.tag, info.epoch);
  }
  void take(const OnItsWay& message) {
    const auto frame = parse_frame(message.frame->message());
    ASSERT_TRUE(frame) << frame.error().message;
    for (auto& [name, seen] : wanted_) {
      if (seen.id != frame->envelope.stream_id) continue;
      const auto read = seen.reader.read(*frame);
      read ? ++exact : ++refused;
      if (!read) continue;
      ASSERT_EQ(read->envelope, message.frame->envelope);
      ASSERT_EQ(name, message.stream);
    }
  }

  Hub& hub_;
  Outbox outbox_;
  std::deque<OnItsWay> link_;
  std::map<std::string, Seen> wanted_;
};

TEST(LateFrames, NoneIsTakenForAnother) {
  std::size_t exact = 0, refused = 0, reused = 0;
  for (unsigned seed = 0; seed < 30; ++seed) {
    std::mt19937 random(seed);
    const auto below = [&random](unsigned limit) { return static_cast<unsigned>(random() % limit); };
    Hub hub({64, {}});
    LateViewer viewer(hub);
    std::array<FakeSender, kStreamNames.size()> senders;
    std::array<TimeUs, kStreamNames.size()> clocks{};
    std::uint32_t epoch = 0;
    TimeUs now = 1'000'000;
    bool stalled = false;
    for (int i = 0; i < 4000; ++i) {
      const std::size_t which = below(kStreamNames.size());
      const std::string name = kStreamNames[which];
      FakeSender& sender = senders[which];
      Stream* stream = hub.find(name);
      const bool live = stream != nullptr && stream->state() == control::StreamInfo::State::kLive;
      const unsigned what = below(100);
      if (what < 2) {
        viewer.subscribe(name, std::array{kRaw, kLinear, kCurved}[below(3)]);
      } else if (what == 2) {
        viewer.unsubscribe(name);
      } else if (what == 3 && live) {
        stream->release(sender);
        hub.unwatched(*stream);
      } else if (what == 4 || (what == 5 && !live)) {  // A sender comes, or announces anew; its clock is its own.
        stream = hub.open(name).value();
        if (!live) {
          ASSERT_TRUE(stream->claim(sender, true));
        }
        ASSERT_TRUE(stream->announce(small_announce(), ++epoch));
        sender = FakeSender();
        sender.tag = stream->tag();
        clocks[which] = static_cast<TimeUs>(below(1'000'000'000));
        reused += stream->id() == 1 ? 1 : 0;
      } else if (what == 6) {
        stalled = !stalled;
      } else if (live) {
        if (what == 7) sender.begin_anew();
        const unsigned keys = what == 8 ? 200 + below(400) : 1 + below(4);
        for (unsigned key = 0; key < keys; ++key) {
          clocks[which] += 1 + below(below(20) == 0 ? 3'000'000 : 50'000);
          now += below(2) == 0 ? 0 : below(40'000);
          ASSERT_TRUE(stream->take_frame(sender.next(clocks[which]), now));
          if (below(2) == 0) stream->deliver();
        }
      }
      now += below(20'000);
      hub.pump(now);
      hub.deliver();
      for (const Stream* each : hub.streams()) hub.find(each->name())->deliver();
      if (!stalled) viewer.write(below(8), now);
      viewer.read(below(6));
      if (HasFatalFailure()) FAIL() << "seed " << seed << ", " << i;
    }
    viewer.read(1'000'000);
    exact += viewer.exact;
    refused += viewer.refused;
  }
  EXPECT_GT(exact, 20'000U);
  EXPECT_EQ(refused, 0U) << "what a broker sends follows from what it sent";
  EXPECT_GT(reused, 30U);
}

}  // namespace
}  // namespace eigencast::broker
