// SPDX-License-Identifier: MIT
#include "broker/operation/statistics.h"

#include <algorithm>
#include <array>
#include <bit>
#include <functional>
#include <numeric>

#include "broker/connections/connection.h"
#include "broker/relay/hub.h"

namespace eigencast::broker {

namespace {

void add_to(EventCounts& sum, const EventCounts& other) {
  using Numbers = std::array<std::uint64_t, sizeof(EventCounts) / sizeof(std::uint64_t)>;
  auto total = std::bit_cast<Numbers>(sum);
  const auto more = std::bit_cast<Numbers>(other);
  std::transform(total.begin(), total.end(), more.begin(), total.begin(), std::plus());
  sum = std::bit_cast<EventCounts>(total);
}

void add_to(Counters& sum, const Counters& other) {
  add_to(static_cast<EventCounts&>(sum), static_cast<const EventCounts&>(other));
  for (const auto& [rung, steps] : other.ladder_down) sum.ladder_down[rung] += steps;
  for (const auto& [rung, steps] : other.ladder_up) sum.ladder_up[rung] += steps;
  sum.latency += other.latency;
  sum.hold += other.hold;
}

}  // namespace

void Statistics::add(const Context& loop) {
  add_to(counters, loop.counters);
  connections.push_back(loop.connection_count);
  for (const Stream* stream : loop.hub.streams()) {
    Made& sum = made[stream->name()];
    sum.frames += stream->frames_made();
    sum.poses_failed += stream->poses_failed();
    sum.profiles += stream->profile_count();
  }
}

void Statistics::add_clients(const Context& loop) {
  for (const Connection* connection : loop.connections) connection->describe(clients.emplace_back());
}

Statistics::Made Statistics::made_of(const std::string& stream) const {
  const auto found = made.find(stream);
  return found == made.end() ? Made{} : found->second;
}

std::uint64_t Statistics::connections_total() const {
  return std::accumulate(connections.begin(), connections.end(), std::uint64_t{0});
}

}  // namespace eigencast::broker
