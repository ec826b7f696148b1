// SPDX-License-Identifier: MIT
#include "tools/latency/timeline.h"

#include <algorithm>

namespace eigencast::latency {
namespace {

constexpr std::size_t kMaxKeys = 256;
constexpr std::size_t kMaxSteps = 16;

}  // namespace

std::string title_of(Stage stage) {
  std::string title(kStageNames[stage]);
  std::replace(title.begin(), title.end(), '_', ' ');
  return title;
}

TimeUs StagedPose::unexplained_us() const {
  TimeUs sum = 0;
  for (const Span& span : stages) sum += span.us;
  return total.us - sum;
}

bool StagedPose::is_possible() const {
  // When a pose is meant for is the sender's to say, and the margin is negative where a key came late.
  for (std::size_t i = 0; i < kStages; ++i) {
    const auto stage = static_cast<Stage>(i);
    if (stage != Stage::kSchedule && stage != Stage::kMargin && stages[i].us < -stages[i].error_us) return false;
  }
  return true;
}

TimeUs StagedPose::uncertainty_us() const {
  TimeUs sum = total.error_us;
  for (const Span& span : stages) sum += span.error_us;
  return sum;
}

void Timeline::add(const Received& received) {
  Key& key = keys_[received.envelope.sequence];
  const bool is_last = received.envelope.step.byte() == 0 || received.envelope.step.at == received.envelope.step.of;
  if (is_last) key.capture_us = received.envelope.capture_us;
  if (key.received.size() < kMaxSteps) key.received[received.envelope.step.byte()] = received;
  settle(received.envelope.sequence, key);
}

void Timeline::add(const control::Trace& trace) {
  Key& key = keys_[trace.sequence];
  key.traced = true;
  std::optional<TimeUs> started, transformed, sent, arrived, scheduled, written;
  for (const auto& [stage, time_us] : trace.stages) {
    if (stage == control::stage::kStarted) started = time_us;
    if (stage == control::stage::kTransformed) transformed = time_us;
    if (stage == control::stage::kSent) sent = time_us;
    if (stage == control::stage::kArrived) arrived = time_us;
    if (stage == control::stage::kScheduled) scheduled = time_us;
    if (stage == control::stage::kWritten) written = time_us;
  }
  if (started && sent) key.sender = Sender{*started, transformed.value_or(*started), *sent, trace.broker_clock};
  if (arrived && written && key.broker.size() < kMaxSteps) key.broker[trace.step] = {*arrived, *written, scheduled};
  settle(trace.sequence, key);
}

void Timeline::settle(std::uint64_t sequence, Key& key) {
  const bool knows_clocks = clocks_.one_machine || (key.sender && key.sender->clock);
  if (key.sender && knows_clocks && key.capture_us) {
    for (auto received = key.received.begin(); received != key.received.end();) {
      const auto broker = key.broker.find(received->first);
      if (broker == key.broker.end() || !(clocks_.one_machine || received->second.clock)) {
        ++received;
        continue;
      }
      done_.push_back(staged(received->second, key, broker->second));
      received = key.received.erase(received);
    }
  }
  // `key` may be what goes here; it is not used any more.
  while (keys_.size() > kMaxKeys) {
    const auto oldest = keys_.begin()->first == sequence ? std::next(keys_.begin()) : keys_.begin();
    if (oldest->second.traced) incomplete_ += oldest->second.received.size();
    keys_.erase(oldest);
  }
}

std::optional<TimeUs> Timeline::min_hold_us(std::uint64_t sequence, const Key& key) const {
  const auto before = keys_.find(sequence - 1);
  if (before == keys_.end() || !before->second.capture_us || key.broker.empty()) return std::nullopt;
  TimeUs of = 0;
  for (const auto& [step, broker] : key.broker) of = std::max<TimeUs>(of, step & 15);
  if (of == 0) return std::nullopt;
  return (*key.capture_us - *before->second.capture_us) * (of - 1) / of;
}

StagedPose Timeline::staged(const Received& r, const Key& key, const Broker& broker) const {
  const Sender& sender = *key.sender;
  const auto up = clocks_.one_machine ? control::Trace::BrokerClock{} : *sender.clock;
  const auto down = clocks_.one_machine ? ViewerClock{} : *r.clock;
  StagedPose pose;
  pose.envelope = r.envelope;
  const TimeUs ready_us = std::max(broker.arrived_us, broker.scheduled_us.value_or(broker.arrived_us));
  pose.at(Stage::kSchedule) = {sender.started_us - *key.capture_us, 0};
  pose.at(Stage::kTransform) = {sender.transformed_us - sender.started_us, 0};
  pose.at(Stage::kEncode) = {sender.sent_us - sender.transformed_us, 0};
  pose.at(Stage::kToBroker) = {broker.arrived_us - up.offset_us - sender.sent_us, up.error_us};
  // A pose between two keys waits for the later one to be made, then for its turn. All poses of an interval are made to
  // wait as long as its first one must; what is beyond that is margin.
  const TimeUs held_us = *key.capture_us - r.envelope.capture_us + ready_us - broker.arrived_us;
  const TimeUs hold_us = broker.scheduled_us ? min_hold_us(r.envelope.sequence, key).value_or(held_us) : held_us;
  pose.at(Stage::kHold) = {hold_us, 0};
  pose.at(Stage::kMargin) = {held_us - hold_us, 0};
  pose.at(Stage::kInBroker) = {broker.written_us - ready_us, 0};
  pose.at(Stage::kToClient) = {r.read_us + down.offset_us - broker.written_us, down.error_us};
  pose.at(Stage::kDecode) = {r.decoded_us - r.read_us, 0};
  pose.at(Stage::kHandOver) = {r.taken_us - r.decoded_us, 0};
  pose.at(Stage::kReconstruct) = {r.rebuilt_us - r.taken_us, 0};
  pose.at(Stage::kPresent) = {r.presented_us - r.rebuilt_us, 0};
  const TimeUs apart_us = clocks_.one_clock ? 0 : down.offset_us - up.offset_us;
  pose.total = {r.presented_us + apart_us - r.envelope.capture_us, clocks_.one_clock ? 0 : up.error_us + down.error_us};
  return pose;
}

}  // namespace eigencast::latency
