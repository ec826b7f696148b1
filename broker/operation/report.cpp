// SPDX-License-Identifier: MIT
#include "broker/operation/report.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <vector>

#include "broker/backbone/backbone.h"

namespace eigencast::broker {
namespace {

using nlohmann::json;

double seconds(TimeUs us) {
  return static_cast<double>(us) * 1e-6;
}
json milliseconds_or_null(std::optional<TimeUs> us) {
  return us ? json(static_cast<double>(*us) * 1e-3) : json();
}

std::string text_of(const json& value) {
  return value.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
}

json json_of(const ClientFacts& facts) {
  json streams = json::array();
  for (const auto& watched : facts.streams) {
    streams.push_back({{"stream", watched.stream}, {"profile", watched.profile}, {"ladder_step", watched.rung}});
  }
  return {{"id", facts.id},
          {"kind", facts.kind == ClientFacts::Kind::kSender ? "sender" : "viewer"},
          {"who", facts.who},
          {"connected_s", seconds(facts.connected_us)},
          {"streams", streams},
          {"round_trip_ms", milliseconds_or_null(facts.round_trip_us)},
          {"acknowledges", facts.acknowledges},
          {"frames_sent", facts.frames_sent},
          {"bytes_sent", facts.bytes_sent},
          {"frames_skipped", facts.skipped},
          {"joins", facts.joins},
          {"control_waiting", facts.control_waiting}};
}

}  // namespace

std::string streams_report(const Context& context, const Facts& facts) {
  json list = json::array();
  for (const Stream* stream : context.hub.streams()) {
    const Facts::Made made = facts.made_of(stream->name());
    list.push_back({{"stream", stream->name()},
                    {"stream_id", stream->id()},
                    {"state", name_of(stream->state())},
                    {"epoch", stream->epoch()},
                    {"asset", stream->asset()},
                    {"codec", stream->announcement().format.codec},
                    {"rows", stream->announcement().format.rows},
                    {"key_rate_hz", stream->key_rate_hz()},
                    {"keys_received", stream->keys_received()},
                    {"frames_made", made.frames},
                    {"poses_failed", made.poses_failed},
                    {"profiles", made.profiles},
                    {"viewers", stream->watchers()}});
  }
  return text_of({{"streams", list}});
}

std::string clients_report(const Facts& facts) {
  std::vector<const ClientFacts*> sorted;
  for (const ClientFacts& client : facts.clients) sorted.push_back(&client);
  std::sort(sorted.begin(), sorted.end(), [](const auto* a, const auto* b) { return a->id < b->id; });
  json list = json::array();
  for (const ClientFacts* client : sorted) list.push_back(json_of(*client));
  return text_of({{"clients", list}});
}

std::string recordings_report(const Context& context) {
  json list = json::array();
  for (const RecordingInfo& info : context.recorder.list()) {
    list.push_back({{"stream", info.stream},
                    {"state", name_of(info.state)},
                    {"file", info.file},
                    {"error", info.error},
                    {"bytes", info.bytes},
                    {"frames", info.frames},
                    {"frames_lost", info.lost},
                    {"duration_s", seconds(info.duration_us)}});
  }
  return text_of({{"recordings", list}});
}

std::string broker_report(const Context& context, const Facts& facts) {
  const Counters& counters = facts.counters;
  const bool degraded = context.backbone != nullptr && !context.backbone->totals().connected;
  return text_of({{"version", context.version},
                  {"session_id", context.session_id},
                  {"uptime_s", seconds(steady_now_us() - context.started_us)},
                  {"state", context.draining ? "draining"
                            : degraded       ? "degraded"
                                             : "ok"},
                  {"backbone", context.backbone == nullptr ? json() : json(context.backbone->status())},
                  {"draining", context.draining},
                  {"threads", facts.connections.size()},
                  {"connections", facts.connections_total()},
                  {"frames_received", counters.frames_received},
                  {"frames_sent", counters.frames_sent},
                  {"frame_bytes_sent", counters.frame_bytes_sent},
                  {"frames_skipped", counters.frames_skipped},
                  {"asset_bytes", context.assets.total_bytes()},
                  {"recordings", context.recorder.totals().active}});
}

}  // namespace eigencast::broker
