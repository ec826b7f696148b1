// SPDX-License-Identifier: MIT
#include "broker/operation/facts.h"

#include <numeric>

#include "broker/connections/connection.h"

namespace eigencast::broker {

namespace {

void add_to(Counters& sum, const Counters& other) {
  sum.connections_total += other.connections_total;
  sum.connections_refused += other.connections_refused;
  sum.frames_received += other.frames_received;
  sum.frames_refused += other.frames_refused;
  sum.frames_sent += other.frames_sent;
  sum.frame_bytes_sent += other.frame_bytes_sent;
  sum.frames_skipped += other.frames_skipped;
  sum.joins_sent += other.joins_sent;
  sum.control_received += other.control_received;
  sum.control_sent += other.control_sent;
  sum.slow_disconnects += other.slow_disconnects;
  for (const auto& [rung, steps] : other.ladder_down) sum.ladder_down[rung] += steps;
  for (const auto& [rung, steps] : other.ladder_up) sum.ladder_up[rung] += steps;
  sum.kicked += other.kicked;
  sum.senders_replaced += other.senders_replaced;
  sum.latency += other.latency;
  sum.hold += other.hold;
  sum.uploads += other.uploads;
  sum.uploads_failed += other.uploads_failed;
  sum.uploads_now += other.uploads_now;
  sum.upload_bytes += other.upload_bytes;
  sum.downloads += other.downloads;
  sum.downloads_now += other.downloads_now;
  sum.download_bytes += other.download_bytes;
}

}  // namespace

void Facts::add(const Context& loop) {
  add_to(counters, loop.counters);
  connections.push_back(loop.open);
  for (const Stream* stream : loop.hub.streams()) {
    Made& sum = made[stream->name()];
    sum.frames += stream->frames_made();
    sum.poses_failed += stream->poses_failed();
    sum.profiles += stream->profile_count();
  }
}

void Facts::add_clients(const Context& loop) {
  for (const Connection* connection : loop.connections) connection->describe(clients.emplace_back());
}

Facts::Made Facts::made_of(const std::string& stream) const {
  const auto found = made.find(stream);
  return found == made.end() ? Made{} : found->second;
}

std::uint64_t Facts::connections_total() const {
  return std::accumulate(connections.begin(), connections.end(), std::uint64_t{0});
}

}  // namespace eigencast::broker
