// SPDX-License-Identifier: MIT
#include "broker/operation/report.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <vector>

#include "broker/backbone/backbone.h"
#include "broker/relay/hub.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/recorder.h"

namespace eigencast::broker {
namespace {

using nlohmann::json;

double seconds(TimeUs us) {
  return static_cast<double>(us) * 1e-6;
}
json milliseconds_or_null(std::optional<TimeUs> us) {
  return us ? json(static_cast<double>(*us) * 1e-3) : json();
}

std::string json_text(const json& value) {
  return value.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
}

json json_of(const ClientInfo& statistics) {
  json streams = json::array();
  for (const auto& watched : statistics.streams) {
    streams.push_back({{"stream", watched.stream}, {"profile", watched.profile}, {"ladder_step", watched.rung}});
  }
  return {{"id", statistics.id},
          {"kind", statistics.kind == ClientInfo::Kind::kSender ? "sender" : "viewer"},
          {"who", statistics.who},
          {"connected_s", seconds(statistics.connected_us)},
          {"streams", streams},
          {"round_trip_ms", milliseconds_or_null(statistics.round_trip_us)},
          {"acknowledges", statistics.acknowledges},
          {"frames_sent", statistics.frames_sent},
          {"bytes_sent", statistics.bytes_sent},
          {"frames_skipped", statistics.skipped},
          {"joins", statistics.joins},
          {"control_waiting", statistics.control_waiting}};
}

}  // namespace

std::string streams_report(const Context& context, const Statistics& statistics) {
  json list = json::array();
  for (const Stream* stream : context.hub.streams()) {
    const Statistics::Made made = statistics.made_of(stream->name());
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
  return json_text({{"streams", list}});
}

std::string clients_report(const Statistics& statistics) {
  std::vector<const ClientInfo*> sorted;
  for (const ClientInfo& client : statistics.clients) sorted.push_back(&client);
  std::sort(sorted.begin(), sorted.end(), [](const auto* a, const auto* b) { return a->id < b->id; });
  json list = json::array();
  for (const ClientInfo* client : sorted) list.push_back(json_of(*client));
  return json_text({{"clients", list}});
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
  return json_text({{"recordings", list}});
}

std::string broker_report(const Context& context, const Statistics& statistics) {
  const Counters& counters = statistics.counters;
  const bool degraded = context.backbone != nullptr && !context.backbone->totals().connected;
  return json_text({{"version", context.version},
                    {"session_id", context.session_id},
                    {"uptime_s", seconds(steady_now_us() - context.started_us)},
                    {"state", context.draining ? "draining"
                              : degraded       ? "degraded"
                                               : "ok"},
                    {"backbone", context.backbone == nullptr ? json() : json(context.backbone->status())},
                    {"draining", context.draining},
                    {"threads", statistics.connections.size()},
                    {"connections", statistics.connections_total()},
                    {"frames_received", counters.frames_received},
                    {"frames_sent", counters.frames_sent},
                    {"frame_bytes_sent", counters.frame_bytes_sent},
                    {"frames_skipped", counters.frames_skipped},
                    {"asset_bytes", context.assets.total_bytes()},
                    {"recordings", context.recorder.totals().active}});
}

}  // namespace eigencast::broker
