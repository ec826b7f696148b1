// SPDX-License-Identifier: MIT
//
// Control messages as JSON objects with an "op" (docs/protocol.md, "Control messages"). The fields of each message are
// stated once, for the reader, which checks every one, and for the writer.
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <type_traits>

#include "common/wire/control.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

using Json = nlohmann::json;             // Its lookups stay fast however many keys a peer sends.
using Written = nlohmann::ordered_json;  // Fields in the order of docs/protocol.md.

constexpr double kMaxKeyRateHz = 10'000;
constexpr std::array<std::string_view, 3> kStates{"waiting", "live", "stalled"};
constexpr std::array<std::string_view, 3> kRates{"raw", "interpolated", "estimated"};
constexpr std::array<std::string_view, 4> kSchemes{"linear", "catmull-rom", "hermite", "damped"};
constexpr std::array<std::string_view, 2> kForms{"full", "compact"};

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
class Reader {
 public:
  template <typename T>
  using Of = T;
  static constexpr bool kReads = true;

  Reader(const Json& json, std::string path, std::optional<Error>& error)
      : json_(json), path_(std::move(path)), error_(error) {}

  /// Whether an optional field is there; the writer asks instead whether it is `worth_writing`.
  bool wants(const char* name, bool /*worth_writing*/) const { return json_.contains(name); }

  template <typename T>
  void integer(const char* name, T& to, std::uint64_t low = 0, std::uint64_t high = std::numeric_limits<T>::max()) {
    if (const Json* field = find(name)) to = integer_from<T>(*field, name, low, high);
  }
  void time(const char* name, TimeUs& to) { integer(name, to, 0, std::uint64_t{limits::kMaxTimeUs}); }
  /// The difference of two times.
  void time_difference(const char* name, TimeUs& to) {
    const Json* field = find(name);
    if (field == nullptr) return;
    if (!field->is_number_integer()) return wrong(name, "must be an integer");
    if (field->is_number_unsigned()) return time(name, to);
    to = field->get<std::int64_t>();
    if (to < -limits::kMaxTimeUs) wrong(name, "must be at least -2^62 + 1");
  }
  void number(const char* name, double& to, double low, double high) {
    const Json* field = find(name);
    if (field == nullptr) return;
    to = field->is_number() ? field->get<double>() : std::nan("");
    if (!(to >= low && to <= high))
      wrong(name, "must be a number of " + std::to_string(low) + " to " + std::to_string(high));
  }
  void text(const char* name, std::string& to) {
    const Json* field = find(name);
    if (field == nullptr) return;
    const auto* value = field->get_ptr<const std::string*>();
    if (value == nullptr || value->size() > limits::kMaxTextBytes)
      return wrong(name, "must be a string of at most " + std::to_string(limits::kMaxTextBytes) + " bytes");
    to = *value;
  }
  void stream_name(const char* name, std::string& to) {
    text(name, to);
    if (error_) return;
    if (const auto checked = check_stream_name(to); !checked) wrong(name, checked.error().message);
  }
  void asset_id(const char* name, std::string& to) {
    text(name, to);
    if (to.size() != 64 || to.find_first_not_of("0123456789abcdef") != std::string::npos)
      wrong(name, "must be 64 lower-case hexadecimal digits");
  }
  /// An enumerator, by its word.
  template <typename Enum, std::size_t kCount>
  void word(const char* name, Enum& to, const std::array<std::string_view, kCount>& words) {
    std::string value, allowed;
    text(name, value);
    for (std::size_t i = 0; i < kCount; ++i) {
      if (value == words[i]) return void(to = static_cast<Enum>(i));
      allowed += (i == 0 ? "" : ", ") + std::string(words[i]);
    }
    wrong(name, "must be one of: " + allowed);
  }
  void integers(const char* name, std::vector<std::uint32_t>& to, std::size_t most, std::uint32_t high) {
    const Json* all = array(name, 1, most);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i)
      to.push_back(integer_from<std::uint32_t>((*all)[i], name, 1, high));
  }
  void numbers(const char* name, std::optional<std::vector<double>>& to, std::size_t count) {
    to.emplace();
    const Json* all = array(name, count, count);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i) {
      // The parser refuses numbers beyond double, so that a number here is finite.
      const Json& value = (*all)[i];
      if (!value.is_number()) wrong(name, "must hold " + std::to_string(count) + " numbers");
      to->push_back(value.is_number() ? value.get<double>() : 0.0);
    }
  }
  template <typename Use>
  void object(const char* name, Use use) {
    const Json* field = find(name);
    element(field == nullptr ? empty() : *field, name, use);
  }
  template <typename Element, typename Use>
  void each(const char* name, std::vector<Element>& to, std::size_t most, Use use) {
    const Json* all = array(name, 0, most);
    for (std::size_t i = 0; all != nullptr && i < all->size(); ++i)
      element((*all)[i], name, [&](Reader& f) { use(f, to.emplace_back()); });
  }
  void check(const char* name, const Result<void>& checked) {
    if (!checked) wrong(name, "is not allowed: " + checked.error().message);
  }

 private:
  static const Json& empty() {
    static const Json object = Json::object();
    return object;
  }
  template <typename Use>
  void element(const Json& json, const char* name, const Use& use) {
    if (!json.is_object()) wrong(name, "must be an object");
    Reader fields(json.is_object() ? json : empty(), path_ + name + ".", error_);
    use(fields);
  }
  const Json* array(const char* name, std::size_t least, std::size_t most) {
    const Json* field = find(name);
    if (field == nullptr || (field->is_array() && field->size() >= least && field->size() <= most)) return field;
    wrong(name, "must be an array of " + std::to_string(least) + " to " + std::to_string(most) + " elements");
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
  void wrong(const std::string& name, const std::string& what) {
    if (!error_) error_ = malformed("field '" + path_ + name + "' " + what);
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

/// Puts the same fields into one JSON object.
class Writer {
 public:
  template <typename T>
  using Of = const T;
  static constexpr bool kReads = false;

  explicit Writer(Written& json) : json_(json) {}

  bool wants(const char* /*name*/, bool worth_writing) const { return worth_writing; }
  template <typename T, typename... Limits>
  void integer(const char* name, const T& value, Limits...) {
    json_[name] = value;
  }
  void time(const char* name, TimeUs value) { json_[name] = value; }
  void time_difference(const char* name, TimeUs value) { json_[name] = value; }
  void number(const char* name, double value, double, double) { json_[name] = value; }
  void text(const char* name, const std::string& value) { json_[name] = value; }
  void stream_name(const char* name, const std::string& value) { json_[name] = value; }
  void asset_id(const char* name, const std::string& value) { json_[name] = value; }
  template <typename Enum, typename Words>
  void word(const char* name, Enum value, const Words& words) {
    json_[name] = words[static_cast<std::size_t>(value)];
  }
  void integers(const char* name, const std::vector<std::uint32_t>& values, std::size_t, std::uint32_t) {
    json_[name] = values;
  }
  void numbers(const char* name, const std::optional<std::vector<double>>& values, std::size_t) {
    json_[name] = *values;
  }
  template <typename Use>
  void object(const char* name, Use use) {
    Writer fields(json_[name] = Written::object());
    use(fields);
  }
  template <typename Element, typename Use>
  void each(const char* name, const std::vector<Element>& elements, std::size_t, Use use) {
    Written& all = json_[name] = Written::array();
    for (const Element& element : elements) {
      Writer fields(all.emplace_back(Written::object()));
      use(fields, element);
    }
  }
  void check(const char* /*name*/, const Result<void>& /*checked*/) {}

 private:
  Written& json_;
};

template <typename F, typename T>
using Of = typename F::template Of<T>;

template <typename F>
void describe_format(F& f, Of<F, StreamFormat>& format) {
  f.object("format", [&](F& fields) {
    fields.integer("rows", format.rows);
    if (fields.wants("channels", true)) fields.integer("channels", format.channels);
    fields.integers("band_ends", format.band_ends, limits::kMaxBands, limits::kMaxRows);
    fields.text("codec", format.codec);
    const bool moves = format.velocity_channels != 0;
    if (fields.wants("velocity_channels", moves)) fields.integer("velocity_channels", format.velocity_channels);
    if (fields.wants("velocity_us", moves)) fields.integer("velocity_us", format.velocity_us);
  });
  if (F::kReads) f.check("format", check_format(format));
}

template <typename F>
void describe_profile(F& f, Of<F, Profile>& profile) {
  if (!f.wants("profile", true)) return;
  f.object("profile", [&](F& fields) {
    if (fields.wants("rate", true)) fields.word("rate", profile.rate, kRates);
    const bool made = profile.rate != Profile::Rate::kRaw;
    if constexpr (F::kReads) profile.scheme = default_scheme(profile.rate);
    if (fields.wants("k", made)) fields.integer("k", profile.k, 2, limits::kMaxInterpolation);
    if (fields.wants("form", made)) fields.word("form", profile.form, kForms);
    if (fields.wants("scheme", made && profile.scheme != default_scheme(profile.rate)))
      fields.word("scheme", profile.scheme, kSchemes);
    if (fields.wants("bands", true)) fields.integer("bands", profile.bands, 1, limits::kMaxBands);
  });
}

template <typename F>
void describe_surface(F& f, Of<F, std::string>& asset, Of<F, StreamFormat>& format, Of<F, double>& key_rate_hz) {
  f.asset_id("asset", asset);
  describe_format(f, format);
  if (f.wants("key_rate_hz", true)) f.number("key_rate_hz", key_rate_hz, 0, kMaxKeyRateHz);
}

template <typename F>
void describe(F& f, Of<F, control::Welcome>& m) {
  f.text("version", m.version);
  f.text("session_id", m.session_id);
  f.time("time_us", m.time_us);
}

template <typename F>
void describe(F& f, Of<F, control::Announce>& m) {
  describe_surface(f, m.asset, m.format, m.key_rate_hz);
  if (f.wants("world", m.world.has_value())) f.numbers("world", m.world, 16);
}

template <typename F>
void describe(F& f, Of<F, control::Announced>& m) {
  f.stream_name("stream", m.stream);
  f.integer("stream_id", m.stream_id);
  f.integer("epoch", m.epoch);
}

template <typename F>
void describe(F& f, Of<F, control::Subscribers>& m) {
  f.stream_name("stream", m.stream);
  f.integer("count", m.count);
}

template <typename F>
void describe(F& f, Of<F, control::Subscribe>& m) {
  f.stream_name("stream", m.stream);
  describe_profile(f, m.profile);
}

template <typename F>
void describe(F& f, Of<F, control::Unsubscribe>& m) {
  f.stream_name("stream", m.stream);
}

template <typename F>
void describe(F& f, Of<F, control::StreamInfo>& m) {
  f.stream_name("stream", m.stream);
  f.word("state", m.state, kStates);
  f.integer("stream_id", m.stream_id);
  f.integer("epoch", m.epoch);
  if (m.state != control::StreamInfo::State::kWaiting) describe_surface(f, m.asset, m.format, m.key_rate_hz);
  describe_profile(f, m.profile);
  if (f.wants("world", m.world.has_value())) f.numbers("world", m.world, 16);
}

template <typename F>
void describe(F& f, Of<F, control::Ack>& m) {
  f.each("items", m.items, limits::kMaxAcksPerMessage, [](F& fields, Of<F, control::Ack::Item>& item) {
    fields.integer("stream_id", item.stream_id);
    fields.integer("sequence", item.sequence);
    fields.integer("step", item.step);
  });
  f.time("time_us", m.time_us);
}

template <typename F>
void describe(F& f, Of<F, control::Ping>& m) {
  f.integer("id", m.id);
  f.time("time_us", m.time_us);
}

template <typename F>
void describe(F& f, Of<F, control::Pong>& m) {
  f.integer("id", m.id);
  f.time("time_us", m.time_us);
  f.time("peer_time_us", m.peer_time_us);
}

template <typename F>
void describe(F& f, Of<F, control::Trace>& m) {
  f.integer("stream_id", m.stream_id);
  f.integer("sequence", m.sequence);
  f.each("stages", m.stages, limits::kMaxTraceStages, [](F& fields, Of<F, std::pair<std::string, TimeUs>>& stage) {
    fields.text("stage", stage.first);
    fields.time("time_us", stage.second);
  });
  if (f.wants("epoch", m.epoch != 0)) f.integer("epoch", m.epoch);
  if (f.wants("step", m.step != 0)) f.integer("step", m.step);
  if (!f.wants("broker_clock", m.broker_clock.has_value())) return;
  if constexpr (F::kReads) m.broker_clock.emplace();
  f.object("broker_clock", [&](F& fields) {
    fields.time_difference("offset_us", m.broker_clock->offset_us);
    fields.time("error_us", m.broker_clock->error_us);
  });
}

template <typename F>
void describe(F& f, Of<F, control::TraceRequest>& m) {
  f.stream_name("stream", m.stream);
  f.integer("every", m.every);
}

template <typename F>
void describe(F& f, Of<F, control::Notice>& m) {
  if (f.wants("stream", true)) f.text("stream", m.stream);
  f.text("message", m.message);
  if (f.wants("skipped_frames", true)) f.integer("skipped_frames", m.skipped_frames);
}

template <typename F>
void describe(F& f, Of<F, control::ErrorMessage>& m) {
  f.text("code", m.code);
  f.text("message", m.message);
  if (f.wants("stream", true)) f.text("stream", m.stream);
}

template <typename F>
void describe(F& f, Of<F, control::Bye>& m) {
  if (f.wants("reason", true)) f.text("reason", m.reason);
  if (f.wants("retry_after_ms", true)) f.integer("retry_after_ms", m.retry_after_ms);
}

/// The "op" of each alternative of ControlMessage.
constexpr std::array<std::string_view, std::variant_size_v<ControlMessage>> kOps{
    "welcome", "announce", "announced", "subscribers",   "subscribe", "unsubscribe", "stream", "ack",
    "ping",    "pong",     "trace",     "trace_request", "notice",    "error",       "bye"};

/// The empty message of an op; nothing if there is no such op.
template <std::size_t kIndex = 0>
std::optional<ControlMessage> message_of(std::string_view op) {
  if constexpr (kIndex < kOps.size()) {
    if (op == kOps[kIndex]) return ControlMessage(std::in_place_index<kIndex>);
    return message_of<kIndex + 1>(op);
  }
  return std::nullopt;
}

}  // namespace

std::string_view control::name_of(StreamInfo::State state) {
  return kStates[static_cast<std::size_t>(state)];
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
  Reader fields(json, "", error);
  std::string op;
  fields.text("op", op);
  if (error) return *error;
  std::optional<ControlMessage> message = message_of(op);
  if (!message) return fail(ErrorCode::kUnsupported, "control message: unknown op '" + op.substr(0, 32) + "'");
  std::visit([&](auto& m) { describe(fields, m); }, *message);
  if (error) return in_context(op, *error);
  return std::move(*message);
}

std::string text_from_control(const ControlMessage& message) {
  Written json{{"op", kOps[message.index()]}};
  Writer fields(json);
  std::visit([&](const auto& m) { describe(fields, m); }, message);
  return json.dump(-1, ' ', false, Written::error_handler_t::replace);
}

}  // namespace eigencast
