// SPDX-License-Identifier: MIT
//
// Control messages written as JSON objects with an "op" (docs/protocol.md, "Control messages").
#include <nlohmann/json.hpp>

#include "common/wire/control.h"

namespace eigencast {
namespace {

using namespace control;
using Written = nlohmann::ordered_json;  // Fields in the order of docs/protocol.md.

template <typename... Ts>
struct Overloaded : Ts... {
  using Ts::operator()...;
};
template <typename... Ts>
Overloaded(Ts...) -> Overloaded<Ts...>;

Written json_from(const StreamFormat& format) {
  Written json{
      {"rows", format.rows}, {"channels", format.channels}, {"band_ends", format.band_ends}, {"codec", format.codec}};
  if (format.velocity_channels != 0) {
    json["velocity_channels"] = format.velocity_channels;
    json["velocity_us"] = format.velocity_us;
  }
  return json;
}

Written json_from(const Profile& profile) {
  Written json{{"rate", name_of(profile.rate)}};
  if (profile.rate != Profile::Rate::kRaw) {
    json["k"] = profile.k;
    json["form"] = profile.form == Profile::Form::kFull ? "full" : "compact";
    if (profile.scheme != default_scheme(profile.rate)) json["scheme"] = name_of(profile.scheme);
  }
  json["bands"] = profile.bands;
  return json;
}

Written json_from(const Announce& m) {
  Written json{{"op", "announce"}, {"asset", m.asset}, {"format", json_from(m.format)}, {"key_rate_hz", m.key_rate_hz}};
  if (m.world) json["world"] = *m.world;
  return json;
}

Written json_from(const StreamInfo& m) {
  Written json{{"op", "stream"},
               {"stream", m.stream},
               {"state", name_of(m.state)},
               {"stream_id", m.stream_id},
               {"epoch", m.epoch}};
  if (m.state != StreamInfo::State::kWaiting) {
    json["asset"] = m.asset;
    json["format"] = json_from(m.format);
    json["key_rate_hz"] = m.key_rate_hz;
  }
  json["profile"] = json_from(m.profile);
  if (m.world) json["world"] = *m.world;
  return json;
}

Written json_from(const Ack& m) {
  Written items = Written::array();
  for (const Ack::Item& item : m.items) {
    items.push_back({{"stream_id", item.stream_id}, {"sequence", item.sequence}, {"step", item.step}});
  }
  return {{"op", "ack"}, {"items", std::move(items)}, {"time_us", m.time_us}};
}

Written json_from(const Trace& m) {
  Written stages = Written::array();
  for (const auto& [stage, time_us] : m.stages) stages.push_back({{"stage", stage}, {"time_us", time_us}});
  Written json{{"op", "trace"}, {"stream_id", m.stream_id}, {"sequence", m.sequence}, {"stages", std::move(stages)}};
  if (m.epoch != 0) json["epoch"] = m.epoch;
  if (m.step != 0) json["step"] = m.step;
  if (m.broker_clock) {
    json["broker_clock"] = {{"offset_us", m.broker_clock->offset_us}, {"error_us", m.broker_clock->error_us}};
  }
  return json;
}

Written json_from_message(const ControlMessage& message) {
  return std::visit(
      Overloaded{
          [](const Welcome& m) -> Written {
            return {{"op", "welcome"}, {"version", m.version}, {"session_id", m.session_id}, {"time_us", m.time_us}};
          },
          [](const Announced& m) -> Written {
            return {{"op", "announced"}, {"stream", m.stream}, {"stream_id", m.stream_id}, {"epoch", m.epoch}};
          },
          [](const Subscribers& m) -> Written {
            return {{"op", "subscribers"}, {"stream", m.stream}, {"count", m.count}};
          },
          [](const Subscribe& m) -> Written {
            return {{"op", "subscribe"}, {"stream", m.stream}, {"profile", json_from(m.profile)}};
          },
          [](const Unsubscribe& m) -> Written {
            return {{"op", "unsubscribe"}, {"stream", m.stream}};
          },
          [](const Ping& m) -> Written {
            return {{"op", "ping"}, {"id", m.id}, {"time_us", m.time_us}};
          },
          [](const Pong& m) -> Written {
            return {{"op", "pong"}, {"id", m.id}, {"time_us", m.time_us}, {"peer_time_us", m.peer_time_us}};
          },
          [](const TraceRequest& m) -> Written {
            return {{"op", "trace_request"}, {"stream", m.stream}, {"every", m.every}};
          },
          [](const Notice& m) -> Written {
            return {
                {"op", "notice"}, {"stream", m.stream}, {"message", m.message}, {"skipped_frames", m.skipped_frames}};
          },
          [](const ErrorMessage& m) -> Written {
            return {{"op", "error"}, {"code", m.code}, {"message", m.message}, {"stream", m.stream}};
          },
          [](const Bye& m) -> Written {
            return {{"op", "bye"}, {"reason", m.reason}, {"retry_after_ms", m.retry_after_ms}};
          },
          [](const auto& m) -> Written { return json_from(m); },
      },
      message);
}

}  // namespace

std::string_view control::name_of(StreamInfo::State state) {
  switch (state) {
    case StreamInfo::State::kWaiting:
      return "waiting";
    case StreamInfo::State::kLive:
      return "live";
    case StreamInfo::State::kStalled:
      return "stalled";
  }
  return "unknown";
}

std::string text_from_control(const ControlMessage& message) {
  return json_from_message(message).dump(-1, ' ', false, Written::error_handler_t::replace);
}

}  // namespace eigencast
