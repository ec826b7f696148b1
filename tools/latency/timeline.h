// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/core/clock.h"
#include "common/core/text.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"

namespace eigencast::latency {

/// In the order of a pose's life. docs/latency.md says what each is.
enum class Stage : std::uint8_t {
  kSchedule,     ///< Intended time to the beginning of the work.
  kTransform,    ///< Positions to coefficients.
  kEncode,       ///< Coefficients to a frame that was handed to the connection.
  kToBroker,     ///< Until the broker had read it.
  kHold,         ///< What interpolation has to wait for: the later of its two keys.
  kMargin,       ///< What it waited beyond that, against jitter; negative where the key was late.
  kInBroker,     ///< Ready to leave, until it was handed to the first viewer's socket.
  kToClient,     ///< Until the viewer had read it.
  kDecode,       ///< Frame to coefficients.
  kHandOver,     ///< Until the viewer's own thread took it.
  kReconstruct,  ///< Coefficients to positions.
  kPresent,      ///< Positions to a finished picture; 0 where none is made.
};
inline constexpr std::size_t kStages = 12;
/// As in reports.
inline constexpr EnumNames<Stage, kStages> kStageNames{{"schedule", "transform", "encode", "to_broker",
                                                        "interpolation_hold", "jitter_margin", "in_broker", "to_client",
                                                        "decode", "hand_over", "reconstruct", "present"}};
/// For people: "to broker".
std::string title_of(Stage stage);

/// Its ends may be stamped by different clocks.
struct Span {
  TimeUs us = 0;
  TimeUs error_us = 0;  ///< Bound on what the offset of the clocks may be wrong by; 0: one clock.
};

struct StagedPose {
  Envelope envelope;
  std::array<Span, kStages> stages{};
  Span total;  ///< Intended time to rebuilt surface, or to its picture where one is made; measured, not summed.
  Span& at(Stage stage) { return stages[static_cast<std::size_t>(stage)]; }
  const Span& at(Stage stage) const { return stages[static_cast<std::size_t>(stage)]; }
  bool is_key() const { return envelope.kind == FrameKind::kKey || envelope.kind == FrameKind::kJoin; }
  TimeUs unexplained_us() const;
  /// False if a stage took less than no time, beyond the clocks' error: a stamp is wrong then.
  bool is_possible() const;
  /// Because of the clocks.
  TimeUs uncertainty_us() const;
};

using ViewerClock = control::Trace::BrokerClock;  ///< The broker's minus ours, as in Subscriber::Stats.

/// Measured on its own clock.
struct Received {
  Envelope envelope;
  TimeUs read_us = 0, decoded_us = 0, taken_us = 0, rebuilt_us = 0;
  TimeUs presented_us = 0;  ///< As rebuilt_us where no picture is made.
  std::optional<ViewerClock> clock;
};

/// Pure; bounded: what stays incomplete for long is given up and counted. Not thread-safe.
class Timeline {
 public:
  struct Clocks {
    bool one_clock = false;    ///< Sender and viewer share a clock (one process): the total needs no offsets.
    bool one_machine = false;  ///< The broker shares it too: no stage needs one.
  };
  explicit Timeline(const Clocks& clocks) : clocks_(clocks) {}

  void add(const Received& received);
  void add(const control::Trace& trace);
  /// In no particular order.
  std::vector<StagedPose> take() { return std::exchange(done_, {}); }
  /// Counts traced keys.
  std::uint64_t incomplete() const { return incomplete_; }

 private:
  struct Sender {
    TimeUs started_us = 0, transformed_us = 0, sent_us = 0;
    std::optional<control::Trace::BrokerClock> clock;
  };
  struct Broker {
    TimeUs arrived_us = 0, written_us = 0;
    std::optional<TimeUs> scheduled_us;
  };
  struct Key {
    std::optional<Sender> sender;
    std::optional<TimeUs> capture_us;
    bool traced = false;
    std::map<std::uint8_t, Broker> broker;      ///< By step byte; at most 16 of each.
    std::map<std::uint8_t, Received> received;  ///< Likewise.
  };
  void settle(std::uint64_t sequence, Key& key);
  StagedPose staged(const Received& received, const Key& key, const Broker& broker) const;
  /// For the first pose of the interval that ends with the key; nothing if it is not known.
  std::optional<TimeUs> min_hold_us(std::uint64_t sequence, const Key& key) const;

  Clocks clocks_;
  std::map<std::uint64_t, Key> keys_;  ///< At most kMaxKeys of the newest.
  std::vector<StagedPose> done_;
  std::uint64_t incomplete_ = 0;
};

}  // namespace eigencast::latency
