// SPDX-License-Identifier: MIT
//
// Control messages read from JSON, every field checked (docs/protocol.md, "Control messages").
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/wire/control.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

using namespace control;
using Json = nlohmann::json;  // Its lookups stay fast however many keys a peer sends.

Error malformed(std::string what) {
  return fail(ErrorCode::kCorrupt, "control message: " + std::move(what));
}

/// Refuses nesting over the limit before the parser sees the text. Brackets inside strings do not count.
bool too_deep(std::string_view text) {
  int depth = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      if (++depth > limits::kMaxControlDepth) return true;
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return false;
}

/// Takes typed fields out of one JSON object. The first thing wrong is kept with the field's path, later reads then
/// give defaults. Borrows the JSON and the error.
class Fields {
 public:
  Fields(const Json& json, std::string path, std::optional<Error>& error)
      : json_(json), path_(std::move(path)), error_(error) {}

  bool has(const char* name) const { return json_.contains(name); }

  template <typename T>
  T integer(const char* name, std::uint64_t low, std::uint64_t high) {
    const Json* field = find(name);
    if (field == nullptr) return T{};
    return integer_from<T>(*field, name, low, high);
  }
  TimeUs time(const char* name) { return integer<TimeUs>(name, 0, std::uint64_t{limits::kMaxTimeUs}); }
  /// The difference of two times.
  TimeUs time_difference(const char* name) {
    const Json* field = find(name);
    if (field == nullptr || !field->is_number_integer()) {
      if (field != nullptr) wrong(name, "must be an integer");
      return 0;
    }
    if (field->is_number_unsigned()) return integer_from<TimeUs>(*field, name, 0, std::uint64_t{limits::kMaxTimeUs});
    const auto value = field->get<std::int64_t>();
    if (value < -limits::kMaxTimeUs) wrong(name, "must be at least -2^62 + 1");
    return value;
  }
  std::uint32_t u32(const char* name) { return integer<std::uint32_t>(name, 0, UINT32_MAX); }
  std::uint64_t u64(const char* name) { return integer<std::uint64_t>(name, 0, UINT64_MAX); }

  double number(const char* name, double low, double high) {
    const Json* field = find(name);
    if (field == nullptr) return 0;
    const double value = field->is_number() ? field->get<double>() : std::nan("");
    if (!(value >= low && value <= high))
      wrong(name, "must be a number of " + std::to_string(low) + " to " + std::to_string(high));
    return value;
  }

  std::string text(const char* name) {
    const Json* field = find(name);
    if (field == nullptr) return {};
    const auto* value = field->get_ptr<const std::string*>();
    if (value == nullptr || value->size() > limits::kMaxTextBytes) {
      wrong(name, "must be a string of at most " + std::to_string(limits::kMaxTextBytes) + " bytes");
      return {};
    }
    return *value;
  }
  std::string text_or_empty(const char* name) { return has(name) ? text(name) : std::string(); }

  std::string stream_name(const char* name) {
    std::string value = text(name);
    if (!error_) {
      if (const auto checked = check_stream_name(value); !checked) wrong(name, checked.error().message);
    }
    return value;
  }

  std::string asset_id(const char* name) {
    std::string value = text(name);
    if (value.size() != 64 || value.find_first_not_of("0123456789abcdef") != std::string::npos) {
      wrong(name, "must be 64 lower-case hexadecimal digits");
    }
    return value;
  }

  /// The elements of an array of at most `most`; null where it is missing or something else.
  const Json* array(const char* name, std::size_t least, std::size_t most) {
    const Json* field = find(name);
    if (field == nullptr) return nullptr;
    if (field->is_array() && field->size() >= least && field->size() <= most) return field;
    wrong(name, "must be an array of " + std::to_string(least) + " to " + std::to_string(most) + " elements");
    return nullptr;
  }

  Fields object(const char* name) {
    const Json* field = find(name);
    return element(field == nullptr ? empty() : *field, name);
  }

  /// One element of an array, or a nested object, as fields.
  Fields element(const Json& json, const std::string& name) {
    if (!json.is_object()) wrong(name, "must be an object");
    return Fields(json.is_object() ? json : empty(), path_ + name + ".", error_);
  }

  /// One of a few words; the index in `words`.
  std::size_t word(const char* name, std::initializer_list<std::string_view> words) {
    const std::string value = text(name);
    std::string allowed;
    std::size_t index = 0;
    for (const std::string_view candidate : words) {
      if (value == candidate) return index;
      allowed += allowed.empty() ? "" : ", ";
      allowed += candidate;
      ++index;
    }
    wrong(name, "must be one of: " + allowed);
    return 0;
  }

  template <typename T>
  T integer_from(const Json& json, const std::string& name, std::uint64_t low, std::uint64_t high) {
    // A non-negative integer of up to 64 bits is held as unsigned by the parser; anything else is negative, a fraction
    // or too large.
    const auto* value = json.get_ptr<const std::uint64_t*>();
    if (value != nullptr && *value >= low && *value <= high) return static_cast<T>(*value);
    wrong(name, "must be an integer of " + std::to_string(low) + " to " + std::to_string(high));
    return T{};
  }

  void wrong(const std::string& name, const std::string& what) {
    if (!error_) error_ = malformed("field '" + path_ + name + "' " + what);
  }

 private:
  static const Json& empty() {
    static const Json object = Json::object();
    return object;
  }

  const Json* find(const char* name) {
    const auto found = json_.find(name);
    if (found != json_.end()) return &*found;
    wrong(name, "is missing");
    return nullptr;
  }

  const Json& json_;
  std::string path_;
  std::optional<Error>& error_;
};

constexpr double kMaxKeyRateHz = 10'000;

StreamFormat format_from(Fields fields, Fields& parent) {
  StreamFormat format;
  format.rows = fields.u32("rows");
  if (fields.has("channels")) format.channels = fields.u32("channels");
  format.codec = fields.text("codec");
  if (const Json* ends = fields.array("band_ends", 1, limits::kMaxBands)) {
    for (const Json& end : *ends) {
      format.band_ends.push_back(fields.integer_from<std::uint32_t>(end, "band_ends", 1, limits::kMaxRows));
    }
  }
  if (fields.has("velocity_channels")) format.velocity_channels = fields.u32("velocity_channels");
  if (fields.has("velocity_us")) format.velocity_us = fields.u32("velocity_us");
  if (const auto checked = check_format(format); !checked)
    parent.wrong("format", "is not allowed: " + checked.error().message);
  return format;
}

Profile profile_from(Fields fields) {
  Profile profile;
  if (fields.has("rate"))
    profile.rate = static_cast<Profile::Rate>(fields.word("rate", {"raw", "interpolated", "estimated"}));
  profile.scheme = default_scheme(profile.rate);
  if (fields.has("scheme"))
    profile.scheme =
        static_cast<Profile::Scheme>(fields.word("scheme", {"linear", "catmull-rom", "hermite", "damped"}));
  if (fields.has("k")) profile.k = fields.integer<std::uint8_t>("k", 2, limits::kMaxInterpolation);
  if (fields.has("form"))
    profile.form = fields.word("form", {"full", "compact"}) == 0 ? Profile::Form::kFull : Profile::Form::kCompact;
  if (fields.has("bands")) profile.bands = fields.integer<std::uint8_t>("bands", 1, limits::kMaxBands);
  return profile;
}

std::optional<std::vector<double>> world_from(Fields& fields) {
  if (!fields.has("world")) return std::nullopt;
  std::vector<double> world;
  if (const Json* array = fields.array("world", 16, 16)) {
    for (const Json& value : *array) {
      // The parser refuses numbers beyond double, so that a number here is finite.
      if (!value.is_number()) fields.wrong("world", "must hold 16 numbers");
      world.push_back(value.is_number() ? value.get<double>() : 0.0);
    }
  }
  return world;
}

ControlMessage welcome_from(Fields& f) {
  return Welcome{f.text("version"), f.text("session_id"), f.time("time_us")};
}

ControlMessage announce_from(Fields& f) {
  Announce m;
  m.asset = f.asset_id("asset");
  m.format = format_from(f.object("format"), f);
  if (f.has("key_rate_hz")) m.key_rate_hz = f.number("key_rate_hz", 0, kMaxKeyRateHz);
  m.world = world_from(f);
  return m;
}

ControlMessage announced_from(Fields& f) {
  return Announced{f.stream_name("stream"), f.u32("stream_id"), f.u32("epoch")};
}
ControlMessage subscribers_from(Fields& f) {
  return Subscribers{f.stream_name("stream"), f.u32("count")};
}

ControlMessage subscribe_from(Fields& f) {
  Subscribe m;
  m.stream = f.stream_name("stream");
  if (f.has("profile")) m.profile = profile_from(f.object("profile"));
  return m;
}

ControlMessage unsubscribe_from(Fields& f) {
  return Unsubscribe{f.stream_name("stream")};
}

ControlMessage stream_from(Fields& f) {
  StreamInfo m;
  m.stream = f.stream_name("stream");
  m.state = static_cast<StreamInfo::State>(f.word("state", {"waiting", "live", "stalled"}));
  m.stream_id = f.u32("stream_id");
  m.epoch = f.u32("epoch");
  if (m.state != StreamInfo::State::kWaiting) {
    m.asset = f.asset_id("asset");
    m.format = format_from(f.object("format"), f);
    if (f.has("key_rate_hz")) m.key_rate_hz = f.number("key_rate_hz", 0, kMaxKeyRateHz);
  }
  if (f.has("profile")) m.profile = profile_from(f.object("profile"));
  m.world = world_from(f);
  return m;
}

ControlMessage ack_from(Fields& f) {
  Ack m;
  if (const Json* items = f.array("items", 0, limits::kMaxAcksPerMessage)) {
    for (const Json& json : *items) {
      Fields item = f.element(json, "items");
      m.items.push_back({item.u32("stream_id"), item.u64("sequence"), item.integer<std::uint8_t>("step", 0, 255)});
    }
  }
  m.time_us = f.time("time_us");
  return m;
}

ControlMessage ping_from(Fields& f) {
  return Ping{f.u64("id"), f.time("time_us")};
}
ControlMessage pong_from(Fields& f) {
  return Pong{f.u64("id"), f.time("time_us"), f.time("peer_time_us")};
}

ControlMessage trace_from(Fields& f) {
  Trace m;
  m.stream_id = f.u32("stream_id");
  m.sequence = f.u64("sequence");
  if (const Json* stages = f.array("stages", 0, limits::kMaxTraceStages)) {
    for (const Json& json : *stages) {
      Fields stage = f.element(json, "stages");
      std::string name = stage.text("stage");
      m.stages.emplace_back(std::move(name), stage.time("time_us"));
    }
  }
  if (f.has("epoch")) m.epoch = f.u32("epoch");
  if (f.has("step")) m.step = f.integer<std::uint8_t>("step", 0, 255);
  if (f.has("broker_clock")) {
    Fields clock = f.object("broker_clock");
    const TimeUs offset_us = clock.time_difference("offset_us");
    m.broker_clock = Trace::BrokerClock{offset_us, clock.time("error_us")};
  }
  return m;
}

ControlMessage trace_request_from(Fields& f) {
  return TraceRequest{f.stream_name("stream"), f.u32("every")};
}

ControlMessage notice_from(Fields& f) {
  Notice m;
  if (f.has("stream")) m.stream = f.text("stream");
  m.message = f.text("message");
  if (f.has("skipped_frames")) m.skipped_frames = f.u64("skipped_frames");
  return m;
}

ControlMessage error_from(Fields& f) {
  return ErrorMessage{f.text("code"), f.text("message"), f.text_or_empty("stream")};
}

ControlMessage bye_from(Fields& f) {
  return Bye{f.text_or_empty("reason"), f.has("retry_after_ms") ? f.u32("retry_after_ms") : 0};
}

struct Operation {
  std::string_view name;
  ControlMessage (*parse)(Fields&);
};

constexpr Operation kOperations[] = {
    {"ack", ack_from},
    {"ping", ping_from},
    {"pong", pong_from},
    {"trace", trace_from},
    {"trace_request", trace_request_from},
    {"stream", stream_from},
    {"notice", notice_from},
    {"welcome", welcome_from},
    {"announce", announce_from},
    {"announced", announced_from},
    {"subscribers", subscribers_from},
    {"subscribe", subscribe_from},
    {"unsubscribe", unsubscribe_from},
    {"error", error_from},
    {"bye", bye_from},
};

}  // namespace

Result<ControlMessage> control_from_text(std::string_view text) {
  if (text.size() > limits::kMaxControlBytes) {
    return fail(ErrorCode::kTooLarge, "control message: " + std::to_string(text.size()) +
                                          " bytes are over the limit of " + std::to_string(limits::kMaxControlBytes));
  }
  if (too_deep(text)) {
    return fail(ErrorCode::kTooLarge,
                "control message: nested deeper than " + std::to_string(limits::kMaxControlDepth));
  }
  const Json json = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (json.is_discarded()) return malformed("it is not JSON");
  if (!json.is_object()) return malformed("it is not a JSON object");

  std::optional<Error> error;
  Fields fields(json, "", error);
  const std::string op = fields.text("op");
  if (error) return *error;
  for (const Operation& operation : kOperations) {
    if (operation.name != op) continue;
    ControlMessage message = operation.parse(fields);
    if (error) return in_context(op, *error);
    return message;
  }
  return fail(ErrorCode::kUnsupported, "control message: unknown op '" + op.substr(0, 32) + "'");
}

}  // namespace eigencast
