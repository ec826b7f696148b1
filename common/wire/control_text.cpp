// SPDX-License-Identifier: MIT
// Control messages as JSON objects with an "op" (docs/protocol.md, "Control messages").
#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "common/wire/control.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

using Json = nlohmann::json;             // Its lookups stay fast however many keys a peer sends.
using Written = nlohmann::ordered_json;  // Fields in the order of docs/protocol.md.

constexpr double kMaxKeyRateHz = 10'000;
constexpr EnumNames<control::StreamInfo::State, 3> kStates{{"waiting", "live", "stalled"}};

Error malformed(std::string what) {
  return fail(ErrorCode::kCorrupt, "control message: " + std::move(what));
}

/// Refuses nesting over the limit before the parser sees the text. Brackets inside strings do not count.
bool too_deep(std::string_view text, int limit = limits::kMaxControlDepth) {
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
      if (++depth > limit) return true;
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return false;
}

bool is_room_key(std::string_view text) {
  return !text.empty() && text.size() <= 32 &&
         text.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789._-") == std::string_view::npos;
}

bool is_colour(std::string_view text) {
  return text.size() == 7 && text[0] == '#' &&
         text.find_first_not_of("0123456789abcdefABCDEF", 1) == std::string_view::npos;
}

bool is_asset_id(std::string_view text) {
  return text.size() == 64 && text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

/// The typed fields of one JSON object: takes them out of it, checking each, or puts them into a new one. The first
/// thing wrong is kept with the field's path, later reads then give defaults. Borrows the JSON and the error.
class Fields {
 public:
  Fields(const Json& from, std::string path, std::optional<Error>& error)
      : from_(&from), path_(std::move(path)), error_(&error) {}
  explicit Fields(Written& to) : to_(&to) {}

  bool reads() const { return from_ != nullptr; }
  /// Whether an optional field is there, or is to be written.
  bool wants(const char* name, bool worth_writing = true) const {
    return reads() ? from_->contains(name) : worth_writing;
  }

  template <typename T>
  void integer(const char* name, T& value, std::uint64_t low = 0, std::uint64_t high = std::numeric_limits<T>::max()) {
    if (const Json* field = find(name, value)) value = integer_from<T>(*field, name, low, high);
  }
  void time(const char* name, TimeUs& value) { integer(name, value, 0, std::uint64_t{limits::kMaxTimeUs}); }
  /// The difference of two times.
  void time_difference(const char* name, TimeUs& value) {
    const Json* field = find(name, value);
    if (field == nullptr) return;
    if (!field->is_number_integer()) return wrong(name, "must be an integer");
    if (field->is_number_unsigned()) return time(name, value);
    value = field->get<std::int64_t>();
    if (value < -limits::kMaxTimeUs) wrong(name, "must be at least -2^62 + 1");
  }
  void number(const char* name, double& value, double low, double high) {
    const Json* field = find(name, value);
    if (field == nullptr) return;
    value = field->is_number() ? field->get<double>() : std::nan("");
    if (!(value >= low && value <= high))
      wrong(name, "must be a number of " + std::to_string(low) + " to " + std::to_string(high));
  }
  void flag(const char* name, bool& value) {
    const Json* field = find(name, value);
    if (field == nullptr) return;
    if (!field->is_boolean()) return wrong(name, "must be true or false");
    value = field->get<bool>();
  }
  void text(const char* name, std::string& value) {
    const Json* field = find(name, value);
    if (field == nullptr) return;
    const auto* text = field->get_ptr<const std::string*>();
    if (text == nullptr || text->size() > limits::kMaxTextBytes)
      return wrong(name, "must be a string of at most " + std::to_string(limits::kMaxTextBytes) + " bytes");
    value = *text;
  }
  void stream_name(const char* name, std::string& value) {
    text(name, value);
    if (reads() && !*error_) check(name, check_stream_name(value), "");
  }
  void asset_id(const char* name, std::string& value) {
    text(name, value);
    if (reads() && !is_asset_id(value)) wrong(name, "must be 64 lower-case hexadecimal digits");
  }
  void asset_ids(const char* name, std::vector<std::string>& values, std::size_t max) {
    const Json* all = array(name, values, 0, max);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i) {
      const auto* text = (*all)[i].get_ptr<const std::string*>();
      if (text == nullptr || !is_asset_id(*text))
        return wrong(name, "must hold texts of 64 lower-case hexadecimal digits");
      values.push_back(*text);
    }
  }
  /// 1 to limits::kMaxRoomNameBytes, no control characters.
  void person(const char* name, std::string& value) {
    text(name, value);
    const auto is_control = [](unsigned char c) { return c < 0x20 || c == 0x7F; };
    if (reads() && (value.empty() || value.size() > limits::kMaxRoomNameBytes ||
                    std::any_of(value.begin(), value.end(), is_control)))
      wrong(name, "must be 1 to " + std::to_string(limits::kMaxRoomNameBytes) + " bytes without control characters");
  }
  void colour(const char* name, std::string& value) {
    text(name, value);
    if (reads() && !is_colour(value)) wrong(name, "must be # and six hexadecimal digits");
  }
  void room_key(const char* name, std::string& value) {
    text(name, value);
    if (reads() && !is_room_key(value)) wrong(name, kRoomKeyRule);
  }
  void room_values(const char* name, std::vector<control::RoomValue>& values) {
    const Json* field = find(name, Written::object());
    for (std::size_t i = 0; !reads() && i < values.size(); ++i)
      (*to_)[name][values[i].key] = Json::parse(values[i].json, nullptr, /*allow_exceptions=*/false);
    if (field == nullptr) return;
    if (!field->is_object() || field->size() > limits::kMaxRoomKeys)
      return wrong(name, "must be an object of at most " + std::to_string(limits::kMaxRoomKeys) + " members");
    for (const auto& [key, value] : field->items()) {
      if (!is_room_key(key)) return wrong(name, kRoomKeyRule);
      values.push_back({key, value.dump(-1, ' ', false, Json::error_handler_t::replace)});
      if (too_deep(values.back().json, limits::kMaxRoomValueDepth))
        return wrong(name, "holds a value nested deeper than " + std::to_string(limits::kMaxRoomValueDepth));
    }
  }
  template <typename Enum, std::size_t kCount>
  void word(const char* name, Enum& value, const EnumNames<Enum, kCount>& words) {
    std::string word(words[value]), allowed;
    text(name, word);
    if (const auto known = words.find(word)) return void(value = *known);
    for (const std::string_view each : words.names) allowed += (allowed.empty() ? "" : ", ") + std::string(each);
    wrong(name, "must be one of: " + allowed);
  }
  void integers(const char* name, std::vector<std::uint32_t>& values, std::size_t max, std::uint32_t high) {
    const Json* all = array(name, values, 1, max);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i)
      values.push_back(integer_from<std::uint32_t>((*all)[i], name, 1, high));
  }
  void numbers(const char* name, std::optional<std::vector<double>>& values, std::size_t count) {
    if (reads()) values.emplace();
    const Json* all = array(name, *values, count, count);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i) {
      // The parser refuses numbers beyond double, so that a number here is finite.
      const Json& value = (*all)[i];
      if (!value.is_number()) wrong(name, "must hold " + std::to_string(count) + " numbers");
      values->push_back(value.is_number() ? value.get<double>() : 0.0);
    }
  }
  template <typename Use>
  void object(const char* name, Use use) {
    const Json* field = find(name, Written::object());
    reads() ? element(field == nullptr ? empty() : *field, name, use) : use(Fields((*to_)[name]));
  }
  template <typename Element, typename Use>
  void each(const char* name, std::vector<Element>& elements, std::size_t max, Use use) {
    const Json* all = array(name, Written::array(), 0, max);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i)
      element((*all)[i], name, [&](Fields f) { use(f, elements.emplace_back()); });
    if (reads()) return;
    for (Element& element : elements) use(Fields((*to_)[name].emplace_back(Written::object())), element);
  }
  void check(const char* name, const Result<void>& checked, const std::string& what = "is not allowed: ") {
    if (!checked) wrong(name, what + checked.error().message);
  }
  void wrong(const std::string& name, const std::string& what) {
    if (!*error_) *error_ = malformed("field '" + path_ + name + "' " + what);
  }

 private:
  static constexpr const char* kRoomKeyRule = "must have names of 1 to 32 of a-z 0-9 . _ -";
  static const Json& empty() {
    static const Json object = Json::object();
    return object;
  }
  template <typename Use>
  void element(const Json& json, const char* name, const Use& use) {
    if (!json.is_object()) wrong(name, "must be an object");
    use(Fields(json.is_object() ? json : empty(), path_ + name + ".", *error_));
  }
  template <typename Value>
  const Json* array(const char* name, const Value& value, std::size_t min, std::size_t max) {
    const Json* field = find(name, value);
    if (field == nullptr || (field->is_array() && field->size() >= min && field->size() <= max)) return field;
    wrong(name, "must be an array of " + std::to_string(min) + " to " + std::to_string(max) + " elements");
    return nullptr;
  }
  template <typename T>
  T integer_from(const Json& json, const char* name, std::uint64_t low, std::uint64_t high) {
    // The parser holds a non-negative integer of up to 64 bits as unsigned; anything else is negative, a fraction or
    // too large.
    const auto* value = json.get_ptr<const std::uint64_t*>();
    if (value != nullptr && *value >= low && *value <= high) return static_cast<T>(*value);
    wrong(name, "must be an integer of " + std::to_string(low) + " to " + std::to_string(high));
    return T{};
  }
  /// The field to read; null where it is missing, and where `value` was written instead.
  template <typename Value>
  const Json* find(const char* name, const Value& value) {
    if (!reads()) {
      (*to_)[name] = value;
      return nullptr;
    }
    const auto found = from_->find(name);
    if (found != from_->end()) return &*found;
    wrong(name, "is missing");
    return nullptr;
  }

  const Json* from_ = nullptr;
  Written* to_ = nullptr;
  std::string path_;
  std::optional<Error>* error_ = nullptr;
};

struct Describe {
  Fields& f;

  void operator()(control::Welcome& m) const {
    f.text("version", m.version);
    f.text("session_id", m.session_id);
    f.time("time_us", m.time_us);
  }
  void operator()(control::Announce& m) const {
    surface(m);
    world(m);
    if (f.wants("resume", !m.resume.empty())) f.text("resume", m.resume);
    if (f.wants("continues", m.continues)) f.flag("continues", m.continues);
    if (f.wants("utc_us", m.utc_us != 0)) f.time_difference("utc_us", m.utc_us);
  }
  void operator()(control::Announced& m) const {
    f.stream_name("stream", m.stream);
    f.integer("stream_id", m.stream_id);
    f.integer("epoch", m.epoch);
    f.integer("tag", m.tag);
    if (f.wants("resume", !m.resume.empty())) f.text("resume", m.resume);
  }
  void operator()(control::Subscribers& m) const {
    f.stream_name("stream", m.stream);
    f.integer("count", m.count);
  }
  void operator()(control::Subscribe& m) const {
    f.stream_name("stream", m.stream);
    profile(m.profile);
    if (f.wants("sync", !m.sync.empty())) f.room_key("sync", m.sync);
  }
  void operator()(control::Late& m) const {
    f.stream_name("stream", m.stream);
    f.time_difference("lag_us", m.lag_us);
  }
  void operator()(control::Moment& m) const {
    f.stream_name("stream", m.stream);
    f.time_difference("lag_us", m.lag_us);
    f.time_difference("delay_us", m.delay_us);
  }
  void operator()(control::Unsubscribe& m) const { f.stream_name("stream", m.stream); }
  void operator()(control::StreamInfo& m) const {
    f.stream_name("stream", m.stream);
    f.word("state", m.state, kStates);
    f.integer("stream_id", m.stream_id);
    f.integer("epoch", m.epoch);
    if (m.state != control::StreamInfo::State::kWaiting) {
      f.integer("tag", m.tag);
      surface(m);
    }
    profile(m.profile);
    world(m);
    if (f.wants("utc_us", m.utc_us != 0)) f.time_difference("utc_us", m.utc_us);
    if (f.wants("next", m.next.has_value())) {
      if (f.reads()) m.next = control::StreamInfo::Next{};
      f.object("next", [&](Fields fields) {
        if (fields.wants("asset", !m.next->asset.empty())) fields.asset_id("asset", m.next->asset);
        if (fields.wants("progress", m.next->asset.empty())) fields.number("progress", m.next->progress, 0, 1);
      });
    }
    if (!f.wants("rewind", m.rewind.has_value())) return;
    if (f.reads()) m.rewind = control::StreamInfo::Rewind{};
    f.object("rewind", [&](Fields fields) {
      fields.time("at_us", m.rewind->at_us);
      fields.time("capture_us", m.rewind->capture_us);
      speed(fields, m.rewind->speed);
    });
  }
  void operator()(control::History& m) const {
    f.stream_name("stream", m.stream);
    if (f.wants("now_us", m.now_us != 0)) f.time("now_us", m.now_us);
    if (f.wants("spans", !m.spans.empty())) {
      f.each("spans", m.spans, limits::kMaxSpans, [](Fields fields, control::History::Span& span) {
        fields.time("from_us", span.from_us);
        fields.time("to_us", span.to_us);
      });
    }
    if (f.wants("code", !m.code.empty())) f.text("code", m.code);
    if (f.wants("message", !m.message.empty())) f.text("message", m.message);
  }
  void operator()(control::Seek& m) const {
    f.stream_name("stream", m.stream);
    f.time("at_us", m.at_us);
    if (f.wants("next", m.next)) f.flag("next", m.next);
    if (f.wants("speed", m.speed != 1)) speed(f, m.speed);
  }
  void operator()(control::Progress& m) const {
    f.stream_name("stream", m.stream);
    f.number("fraction", m.fraction, 0, 1);
  }
  void operator()(control::Prepared& m) const {
    f.stream_name("stream", m.stream);
    f.asset_id("asset", m.asset);
  }
  void operator()(control::Ack& m) const {
    f.each("items", m.items, limits::kMaxAcksPerMessage, [](Fields fields, control::Ack::Item& item) {
      fields.integer("stream_id", item.stream_id);
      fields.integer("sequence", item.sequence);
      fields.integer("step", item.step);
      if (fields.wants("generation", item.generation != 0)) fields.integer("generation", item.generation);
    });
    f.time("time_us", m.time_us);
  }
  void operator()(control::Ping& m) const {
    f.integer("id", m.id);
    f.time("time_us", m.time_us);
  }
  void operator()(control::Pong& m) const {
    f.integer("id", m.id);
    f.time("time_us", m.time_us);
    f.time("peer_time_us", m.peer_time_us);
  }
  void operator()(control::Trace& m) const {
    f.integer("stream_id", m.stream_id);
    f.integer("sequence", m.sequence);
    f.each("stages", m.stages, limits::kMaxTraceStages, [](Fields fields, std::pair<std::string, TimeUs>& stage) {
      fields.text("stage", stage.first);
      fields.time("time_us", stage.second);
    });
    if (f.wants("epoch", m.epoch != 0)) f.integer("epoch", m.epoch);
    if (f.wants("step", m.step != 0)) f.integer("step", m.step);
    if (!f.wants("broker_clock", m.broker_clock.has_value())) return;
    if (f.reads()) m.broker_clock = control::Trace::BrokerClock{};
    f.object("broker_clock", [&](Fields fields) {
      fields.time_difference("offset_us", m.broker_clock->offset_us);
      fields.time("error_us", m.broker_clock->error_us);
    });
  }
  void operator()(control::TraceRequest& m) const {
    f.stream_name("stream", m.stream);
    f.integer("every", m.every);
  }
  void operator()(control::Notice& m) const {
    if (f.wants("stream")) f.text("stream", m.stream);
    f.text("message", m.message);
    if (f.wants("frames_dropped")) f.integer("frames_dropped", m.frames_dropped);
  }
  void operator()(control::ErrorMessage& m) const {
    f.text("code", m.code);
    f.text("message", m.message);
    if (f.wants("stream")) f.text("stream", m.stream);
    if (f.wants("room", !m.room.empty())) f.text("room", m.room);
  }
  void operator()(control::Bye& m) const {
    if (f.wants("reason")) f.text("reason", m.reason);
    if (f.wants("retry_after_ms")) f.integer("retry_after_ms", m.retry_after_ms);
  }
  void operator()(control::Remember& m) const {
    f.stream_name("stream", m.stream);
    f.integer("generation", m.generation, 1);
    if (f.wants("kept", m.kept != 0)) f.integer("kept", m.kept, 0, limits::kMaxMemorySegments);
    f.asset_ids("segments", m.segments, limits::kMaxMemorySegments);
  }
  void operator()(control::Remembered& m) const {
    f.stream_name("stream", m.stream);
    f.integer("generation", m.generation, 1);
    if (f.wants("code", !m.code.empty())) f.text("code", m.code);
    if (f.wants("message", !m.message.empty())) f.text("message", m.message);
  }
  void operator()(control::Enter& m) const {
    f.stream_name("room", m.room);
    f.person("name", m.name);
    if (f.wants("colour")) f.colour("colour", m.colour);
    if (f.wants("resume", !m.resume.empty())) f.text("resume", m.resume);
  }
  void operator()(control::Leave& m) const { f.stream_name("room", m.room); }
  void operator()(control::Say& m) const {
    f.stream_name("room", m.room);
    f.room_values("values", m.values);
    if (f.wants("keep", m.keep)) f.flag("keep", m.keep);
    if (f.wants("member", m.member != 0)) f.integer("member", m.member);
  }
  void operator()(control::Floor& m) const {
    f.stream_name("room", m.room);
    f.room_key("floor", m.floor);
    if (f.wants("take", !m.take)) f.flag("take", m.take);
  }
  void operator()(control::Room& m) const {
    f.stream_name("room", m.room);
    if (f.wants("self", m.self != 0)) f.integer("self", m.self);
    if (f.wants("resume", !m.resume.empty())) f.text("resume", m.resume);
    if (f.wants("speaks", m.speaks)) f.flag("speaks", m.speaks);
    if (f.wants("whole", m.whole)) f.flag("whole", m.whole);
    if (f.wants("members", !m.members.empty())) {
      f.each("members", m.members, limits::kMaxRoomMembers, [](Fields fields, control::Room::Member& member) {
        fields.integer("id", member.id, 1);
        if (fields.wants("name", !member.name.empty())) fields.person("name", member.name);
        if (fields.wants("colour", !member.colour.empty())) fields.colour("colour", member.colour);
        if (fields.wants("here", !member.here)) fields.flag("here", member.here);
        if (fields.wants("values", !member.values.empty())) fields.room_values("values", member.values);
      });
    }
    if (f.wants("gone", !m.gone.empty()))
      f.integers("gone", m.gone, limits::kMaxRoomMembers, std::numeric_limits<std::uint32_t>::max());
    if (!f.wants("floors", !m.floors.empty())) return;
    f.each("floors", m.floors, limits::kMaxRoomFloors, [](Fields fields, control::Room::Holder& holder) {
      fields.room_key("floor", holder.floor);
      fields.integer("member", holder.member);
    });
  }

 private:
  void format(StreamFormat& format) const {
    f.object("format", [&](Fields fields) {
      fields.integer("rows", format.rows);
      if (fields.wants("channels")) fields.integer("channels", format.channels);
      fields.integers("band_ends", format.band_ends, limits::kMaxBands, limits::kMaxRows);
      fields.text("codec", format.codec);
      const bool moves = format.velocity_channels != 0;
      if (fields.wants("velocity_channels", moves)) fields.integer("velocity_channels", format.velocity_channels);
      if (fields.wants("velocity_us", moves)) fields.integer("velocity_us", format.velocity_us);
      if (!fields.wants("scalars", !format.scalars.empty())) return;
      fields.each("scalars", format.scalars, limits::kMaxChannels, [](Fields each, ScalarChannel& scalar) {
        each.text("name", scalar.name);
        if (each.wants("unit", !scalar.unit.empty())) each.text("unit", scalar.unit);
        const bool ranged = scalar.low < scalar.high;
        if (each.wants("low", ranged)) each.number("low", scalar.low, -limits::kMaxScalar, limits::kMaxScalar);
        if (each.wants("high", ranged)) each.number("high", scalar.high, scalar.low, limits::kMaxScalar);
        each.number("scale", scalar.scale, 1 / limits::kMaxScalar, limits::kMaxScalar);
      });
    });
    if (f.reads()) f.check("format", check_format(format));
  }
  void profile(Profile& profile) const {
    if (!f.wants("profile")) return;
    f.object("profile", [&](Fields fields) {
      if (fields.wants("rate")) fields.word("rate", profile.rate, kRateNames);
      const bool made = profile.rate != Profile::Rate::kRaw;
      if (fields.reads()) profile.scheme = default_scheme(profile.rate);
      if (fields.wants("k", made)) fields.integer("k", profile.k, 2, limits::kMaxInterpolation);
      if (fields.wants("scheme", made && profile.scheme != default_scheme(profile.rate)))
        fields.word("scheme", profile.scheme, kSchemeNames);
      if (fields.wants("bands")) fields.integer("bands", profile.bands, 1, limits::kMaxBands);
    });
  }
  static void speed(Fields fields, double& speed) {
    fields.number("speed", speed, 0, limits::kMaxSpeed);
    if (fields.reads() && speed != 0 && speed * limits::kMaxSpeed < 1)
      fields.wrong("speed", "must be 0, or at least 1 / " + std::to_string(limits::kMaxSpeed));
  }
  template <typename Message>
  void surface(Message& m) const {
    f.asset_id("asset", m.asset);
    format(m.format);
    if (f.wants("key_rate_hz")) f.number("key_rate_hz", m.key_rate_hz, 0, kMaxKeyRateHz);
  }
  template <typename Message>
  void world(Message& m) const {
    if (f.wants("world", m.world.has_value())) f.numbers("world", m.world, 16);
  }
};

constexpr std::array<std::string_view, std::variant_size_v<ControlMessage>> kOps{
    "welcome", "announce", "announced",  "subscribers", "subscribe",     "unsubscribe", "stream",
    "ack",     "ping",     "pong",       "trace",       "trace_request", "notice",      "error",
    "bye",     "remember", "remembered", "progress",    "prepared",      "enter",       "leave",
    "say",     "floor",    "room",       "late",        "moment",        "history",     "seek"};

template <std::size_t kIndex = 0>
std::optional<ControlMessage> message_of(std::string_view op) {
  if constexpr (kIndex < kOps.size()) {
    if (op == kOps[kIndex]) return ControlMessage(std::in_place_index<kIndex>);
    return message_of<kIndex + 1>(op);
  }
  return std::nullopt;
}

/// Puts them where docs/protocol.md has them. Values are JSON already, of which there may be much.
void insert_members(std::string& text, const std::vector<control::Room::Member>& members) {
  const auto quoted = [](const std::string& value) {
    return Json(value).dump(-1, ' ', false, Json::error_handler_t::replace);
  };
  std::string all;
  for (const control::Room::Member& member : members) {
    all += all.empty() ? ",\"members\":[{\"id\":" : ",{\"id\":";
    all += std::to_string(member.id);
    if (!member.name.empty()) all += ",\"name\":" + quoted(member.name);
    if (!member.colour.empty()) all += ",\"colour\":" + quoted(member.colour);
    if (!member.here) all += ",\"here\":false";
    if (!member.values.empty()) all += ",\"values\":{";
    for (const control::RoomValue& value : member.values)
      all.append("\"").append(value.key).append("\":").append(value.json).append(",");
    if (!member.values.empty()) all.back() = '}';
    all += "}";
  }
  // Quotes within texts have a backslash before them.
  text.insert(std::min({text.find(",\"gone\":"), text.find(",\"floors\":"), text.size() - 1}), all + "]");
}

}  // namespace

std::string_view control::name_of(StreamInfo::State state) {
  return kStates[state];
}

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
  std::string op;
  fields.text("op", op);
  if (error) return *error;
  std::optional<ControlMessage> message = message_of(op);
  if (!message) return fail(ErrorCode::kUnsupported, "control message: unknown op '" + op.substr(0, 32) + "'");
  std::visit(Describe{fields}, *message);
  if (error) return in_context(op, *error);
  return std::move(*message);
}

TimeUs moment_of(const control::StreamInfo::Rewind& rewind, TimeUs capture_us) {
  constexpr double kFarUs = 1e18;  // Beyond what a broker that means well says.
  const double since_us = static_cast<double>(capture_us - rewind.capture_us) * rewind.speed;
  return rewind.at_us + std::llround(std::clamp(since_us, -kFarUs, kFarUs));
}

TimeUs utc_of(const control::StreamInfo& info, TimeUs capture_us) {
  if (!info.rewind) return bounded_time(info.utc_us) + bounded_time(capture_us);
  const control::StreamInfo::Rewind there{bounded_time(info.rewind->capture_us), info.rewind->capture_us,
                                          info.rewind->speed};
  return bounded_time(info.utc_us) + bounded_time(moment_of(there, capture_us));
}

std::string text_from_control(ControlMessage message) {
  auto* const room = std::get_if<control::Room>(&message);
  const auto members = room != nullptr ? std::exchange(room->members, {}) : std::vector<control::Room::Member>();
  Written json{{"op", kOps[message.index()]}};
  Fields fields(json);
  std::visit(Describe{fields}, message);
  std::string text = json.dump(-1, ' ', false, Written::error_handler_t::replace);
  if (!members.empty()) insert_members(text, members);
  return text;
}

}  // namespace eigencast
