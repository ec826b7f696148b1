// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/core/text.h"

namespace eigencast {

/// What a subscriber wants of a stream: its profile.
struct Profile {
  enum class Rate : std::uint8_t { kRaw, kInterpolated, kEstimated };
  /// How poses are made: linear, Catmull-Rom or Hermite where interpolated; linear (Eq. 9) or damped where estimated.
  enum class Scheme : std::uint8_t { kLinear, kCatmullRom, kHermite, kDamped };
  Rate rate = Rate::kInterpolated;
  std::uint8_t k = 3;      ///< Poses per key interval unless raw: 2..15 (default: 3).
  std::uint8_t bands = 8;  ///< How many bands from the lowest; more than the stream has means all (default: all).
  Scheme scheme = Scheme::kLinear;  ///< The default of a query or message is damped where estimated.
  auto operator<=>(const Profile&) const = default;
};

/// A value that rides on each vertex, in a channel of its own.
struct ScalarChannel {
  std::string name;          ///< 1 to 64 of letters, digits, '.', '_' and '-'; differs from the others.
  std::string unit{};        ///< At most 16 bytes without control characters; empty: none.
  double low = 0, high = 0;  ///< The range to expect; equal: unknown.
  double scale = 1;          ///< The channel holds the value times this, so that one step suits all channels.
  bool operator==(const ScalarChannel&) const = default;
};

/// The numbers of a stream's frames: which coefficients and how they are coded.
struct StreamFormat {
  std::uint32_t rows = 0;                ///< r, 1..limits::kMaxRows
  std::uint32_t channels = 3;            ///< c, 1..limits::kMaxChannels; the first three are x, y, z
  std::vector<std::uint32_t> band_ends;  ///< Ascending, last == rows, at most limits::kMaxBands.
  std::string codec = "quantised";       ///< "quantised", "float32" or "float64".
  std::uint32_t velocity_channels = 0;   ///< The last so many channels are velocities of the first; 0 or 2 x this <= c.
  std::uint32_t velocity_us = 1'000'000;  ///< They hold the movement per so many us; 1..limits::kMaxVelocityUs.
  std::vector<ScalarChannel> scalars{};   ///< All channels between positions and velocities; or none.
  bool operator==(const StreamFormat&) const = default;
};

// The messages. Each is one JSON object in one text message; its "op" is given beside it. Unknown fields are ignored,
// unknown ops are answered by an error message (docs/protocol.md).
namespace control {

/// What both ends of the WebSocket must agree on (Sec-WebSocket-Protocol).
inline constexpr std::string_view kSubprotocol = "eigencast.v2";

/// "welcome", broker to everybody, first message.
struct Welcome {
  std::string version;     ///< Names the broker's software.
  std::string session_id;  ///< New with each start of the broker: distinguishes a reconnect from a restart.
  TimeUs time_us = 0;      ///< The broker's clock.
};

/// "announce", sender to broker: the surface that the frames to come deform. Answered by Announced or Error.
struct Announce {
  std::string asset;  ///< 64 hex digits; the broker must have it (PUT /v1/assets/...), else Error "not-found".
  StreamFormat format;
  double key_rate_hz = 0;                    ///< Intended; 0 = unknown.
  std::optional<std::vector<double>> world;  ///< 16 numbers, column-major: scene_from_asset.
  std::string resume = {};                   ///< That of this sender's last Announced. Secret; empty: none.
  /// Of the surface of the present epoch, which goes on, its frames too, until the first frame of the new one. Answered
  /// once most viewers have its asset (see Prepared).
  bool continues = false;
  TimeUs utc_us = 0;  ///< Since 1970, where its clock of capture times says 0.
  bool operator==(const Announce&) const = default;
};

/// "announced", broker to sender.
struct Announced {
  std::string stream;
  std::uint32_t stream_id = 0;
  std::uint32_t epoch = 0;
  std::uint8_t tag = 0;     ///< Stands for the epoch in frames.
  std::string resume = {};  ///< Takes the stream over, see Announce. Secret; empty: an older broker.
};

/// "remember", sender to broker and broker to viewer: poses that keys may be predicted from (see PoseMemory).
struct Remember {
  std::string stream;
  std::uint32_t generation = 0;       ///< Names this memory; the broker's and the sender's numbers differ.
  std::uint32_t kept = 0;             ///< So many segments of the memory before go first; less than it has: a new root.
  std::vector<std::string> segments;  ///< Then these: 64 hex digits each; the broker has them as objects.
};

/// "remembered", broker to sender: its memory of that generation may be used, or why not.
struct Remembered {
  std::string stream;
  std::uint32_t generation = 0;
  std::string code = {};  ///< A name_of(ErrorCode); empty: it may be used.
  std::string message = {};
};

/// "progress", sender to broker: how much of the asset is done that is to replace the present one (StreamInfo::Next).
struct Progress {
  std::string stream;
  double fraction = 0;  ///< 0..1
};

/// "prepared", viewer to broker: it holds the whole asset of StreamInfo::Next.
struct Prepared {
  std::string stream;
  std::string asset;
};

/// "subscribers", broker to sender: how many watch now.
struct Subscribers {
  std::string stream;
  std::uint32_t count = 0;
};

/// "subscribe", client to broker; once more for the same stream changes the profile.
struct Subscribe {
  std::string stream;
  Profile profile;
  /// Viewers of a group show the same moment, see Moment: a key as of RoomValue; empty: none.
  std::string sync = {};
};

/// "unsubscribe", client to broker.
struct Unsubscribe {
  std::string stream;
};

/// "stream", broker to client: what a stream is now. Sent after subscribe and whenever it changes.
struct StreamInfo {
  /// No sender yet; sender there; sender gone, last pose held.
  enum class State : std::uint8_t { kWaiting, kLive, kStalled };
  std::string stream;
  State state = State::kWaiting;
  std::uint32_t stream_id = 0;  ///< Set in every state.
  std::uint32_t epoch = 0;      ///< 0 while kWaiting.
  std::uint8_t tag = 0;         ///< Stands for the epoch in frames; 0 while kWaiting.
  std::string asset;            ///< Empty while kWaiting.
  StreamFormat format;
  double key_rate_hz = 0;
  Profile profile;  ///< What this subscriber gets.
  std::optional<std::vector<double>> world;
  /// Of the same surface: what the next epoch is to bring.
  struct Next {
    std::string asset = {};  ///< To be fetched meanwhile; empty: it is being made,
    double progress = 1;     ///< and so much of it is done, 0..1.
    bool operator==(const Next&) const = default;
  };
  std::optional<Next> next{};
  /// What this subscriber gets is of the past: the pose of capture time t is that of at_us + (t - capture_us) speed.
  struct Rewind {
    TimeUs at_us = 0;  ///< As History::now_us.
    TimeUs capture_us = 0;
    double speed = 1;  ///< 0: the pose of at_us alone.
    bool operator==(const Rewind&) const = default;
  };
  std::optional<Rewind> rewind{};
  TimeUs utc_us = 0;  ///< As Announce's; of the past: see utc_of().
};

std::string_view name_of(StreamInfo::State state);

/// "history", client to broker: asks what may be seen again of a stream; broker to client: that, or why a Seek was not
/// done.
struct History {
  struct Span {
    TimeUs from_us = 0, to_us = 0;
    bool operator==(const Span&) const = default;
  };
  std::string stream;
  TimeUs now_us = 0;             ///< Microseconds since 1970, by the broker. The client's: 0.
  std::vector<Span> spans = {};  ///< Ascending, at most limits::kMaxSpans.
  std::string code = {};         ///< A name_of(ErrorCode); empty: it does not answer a seek.
  std::string message = {};
};

/// "seek", client to broker, of a stream that it watches: show the past. Subscribe shows the present again.
struct Seek {
  std::string stream;
  TimeUs at_us = 0;   ///< As History::now_us: the newest pose at that time first,
  bool next = false;  ///< or the first one after it.
  double speed = 1;   ///< 0: that pose alone; else 1 / limits::kMaxSpeed to limits::kMaxSpeed.
};

/// "ack", client to broker, ten or more times a second: the newest frame received of each stream.
struct Ack {
  struct Item {
    std::uint32_t stream_id = 0;
    std::uint64_t sequence = 0;
    std::uint8_t step = 0;         ///< The step byte of the acknowledged envelope.
    std::uint32_t generation = 0;  ///< Of the memory that the viewer holds by now; 0: not said.
  };
  std::vector<Item> items;
  TimeUs time_us = 0;  ///< Client's clock.
};

/// "ping", either way; answered at once by "pong" with id and time_us copied and the answerer's clock added.
struct Ping {
  std::uint64_t id = 0;
  TimeUs time_us = 0;
};
struct Pong {
  std::uint64_t id = 0;
  TimeUs time_us = 0;
  TimeUs peer_time_us = 0;
};

/// "trace", sender to broker to clients and broker to clients, sampled: when the stages of one frame's life happened,
/// on the clock of the program that stamped them.
struct Trace {
  std::uint32_t stream_id = 0;
  std::uint64_t sequence = 0;
  std::vector<std::pair<std::string, TimeUs>> stages;
  std::uint32_t epoch = 0;  ///< 0: not said.
  std::uint8_t step = 0;    ///< The step byte of the frame's envelope.
  /// How the stamper's clock relates to the broker's.
  struct BrokerClock {
    TimeUs offset_us = 0;  ///< The broker's clock is ahead of the stamper's by so much,
    TimeUs error_us = 0;   ///< give or take this.
  };
  std::optional<BrokerClock> broker_clock;  ///< A sender's trace has it, once it knows.
};

/// "trace_request", viewer to broker: traces of every so many keys of a stream that it watches, please; and broker to
/// sender: somebody wants them.
struct TraceRequest {
  std::string stream;
  std::uint32_t every = 0;  ///< Keys whose sequence is a multiple of it; 0: none (any more).
};

/// The stages that this version stamps (docs/protocol.md).
namespace stage {
inline constexpr std::string_view kStarted = "started";          ///< Sender: work on the pose started.
inline constexpr std::string_view kTransformed = "transformed";  ///< Sender: its coefficients are there.
inline constexpr std::string_view kSent = "sent";                ///< Sender: the frame is there, and handed over.
inline constexpr std::string_view kArrived = "arrived";          ///< Broker: the key was read.
inline constexpr std::string_view kScheduled = "scheduled";      ///< Broker: when the pose was due, if it was held.
inline constexpr std::string_view kWritten = "written";  ///< Broker: the frame was handed to the first viewer's socket.
}  // namespace stage

/// "notice", broker to client at most once a second: what was done to this connection and which knob changes it.
struct Notice {
  std::string stream;
  std::string message;
  std::uint64_t frames_dropped = 0;
};

/// "error", broker to anyone. `code` is a name_of(ErrorCode).
struct ErrorMessage {
  std::string code;
  std::string message;
  std::string stream;     ///< Empty when it concerns the connection, or
  std::string room = {};  ///< a room: one of enter, say and floor was refused.
};

/// "bye", broker to everybody before it closes.
struct Bye {
  std::string reason;
  std::uint32_t retry_after_ms = 0;  ///< 0 = do not come back.
};

/// "enter", viewer to broker: be in a room; once more: be called otherwise there. Answered by Room or Error.
struct Enter {
  std::string room;                ///< As names of streams.
  std::string name;                ///< Of who enters: 1 to limits::kMaxRoomNameBytes without control characters.
  std::string colour = "#808080";  ///< "#" and six hexadecimal digits.
  std::string resume = {};         ///< That of this member's last Room, whose place it takes. Secret; empty: none.
};

/// "late", viewer to broker, of a stream that it watches with `sync`.
struct Late {
  std::string stream;
  TimeUs lag_us = 0;  ///< The least of Moment with which poses of late would have been there in time.
};

/// "moment", broker to viewer: at t on the broker's clock the pose of capture time t - lag_us is to be shown.
struct Moment {
  std::string stream;
  TimeUs lag_us = 0;
  TimeUs delay_us = 0;  ///< So much of it is behind the fastest arrivals.
};

/// "leave", viewer to broker.
struct Leave {
  std::string room;
};

/// What a member says under a key, 1 to 32 of [a-z0-9._-]: JSON text of at most limits::kMaxRoomValueDepth levels,
/// which the broker does not interpret. "null": nothing any more.
struct RoomValue {
  std::string key;
  std::string json;
  bool operator==(const RoomValue&) const = default;
};

/// "say", viewer to broker: values that replace those of the same keys.
struct Say {
  std::string room;
  std::vector<RoomValue> values;
  bool keep = false;         ///< They outlive the member, until the room ends or somebody removes them.
  std::uint32_t member = 0;  ///< 0: the sender; else who has left, whose values may be removed only.
};

/// "floor", viewer to broker: what one member has at a time, such as the lead; the last who takes it has it.
struct Floor {
  std::string room;
  std::string floor;  ///< As keys of values.
  bool take = true;   ///< False: gives it back.
};

/// "room", broker to viewer: who one is there, then what has changed, at most ten times a second.
struct Room {
  struct Member {
    std::uint32_t id = 0;
    std::string name = {}, colour = {};  ///< Empty: as before.
    bool here = true;                    ///< False: it has left, and what it kept is there.
    std::vector<RoomValue> values = {};  ///< That have changed.
    bool operator==(const Member&) const = default;
  };
  struct Holder {
    std::string floor;
    std::uint32_t member = 0;  ///< 0: nobody.
    bool operator==(const Holder&) const = default;
  };
  std::string room;
  std::uint32_t self = 0;            ///< The answer to Enter: the receiver's id; 0: not said.
  std::string resume = {};           ///< With it, see Enter. Secret.
  bool speaks = false;               ///< With it: whether the receiver may say and take anything.
  bool whole = false;                ///< Nothing of before counts.
  std::vector<Member> members = {};  ///< New and changed ones.
  std::vector<std::uint32_t> gone = {};
  std::vector<Holder> floors = {};
};

using Message = std::variant<Welcome, Announce, Announced, Subscribers, Subscribe, Unsubscribe, StreamInfo, Ack, Ping,
                             Pong, Trace, TraceRequest, Notice, ErrorMessage, Bye, Remember, Remembered, Progress,
                             Prepared, Enter, Leave, Say, Floor, Room, Late, Moment, History, Seek>;

}  // namespace control

/// On the broker's clock, as in History, of a pose of a rewound stream.
TimeUs moment_of(const control::StreamInfo::Rewind& rewind, TimeUs capture_us);

/// When a pose of the stream was captured, since 1970; with a sender that does not say it, on its own clock.
TimeUs utc_of(const control::StreamInfo& info, TimeUs capture_us);

using ControlMessage = control::Message;

/// The JSON text of a message. Text that is not UTF-8 is written with U+FFFD in its place.
/// REQUIRES: numbers are finite and within the ranges that control_from_text checks.
std::string text_from_control(ControlMessage message);

/// Parses and checks one text message. Safe on hostile input: size and depth are capped, every number is range-checked.
/// Errors: kTooLarge, kCorrupt (not JSON, wrong type, out of range; the message names the field), kUnsupported (unknown
/// op).
Result<ControlMessage> control_from_text(std::string_view text);

/// Segments of [A-Za-z0-9._-] joined by '/', at most 128 bytes, no segment "." or "..".
Result<void> check_stream_name(std::string_view name);
/// Whether rate and scheme go together. Errors: kInvalidArgument saying what to ask for.
Result<void> check_profile(const Profile& profile);

/// The words of queries and messages.
inline constexpr EnumNames<Profile::Rate, 3> kRateNames{{"raw", "interpolated", "estimated"}};
inline constexpr EnumNames<Profile::Scheme, 4> kSchemeNames{{"linear", "catmull-rom", "hermite", "damped"}};
/// What a query or message without a scheme means.
Profile::Scheme default_scheme(Profile::Rate rate);

/// Against limits.h. Errors: kInvalidArgument naming the field and what it may be.
Result<void> check_format(const StreamFormat& format);

/// The profile that the query of a subscribe URL asks for: "rate=raw", "rate=interpolated&k=3&bands=2";
/// "rate=3" is short for interpolated with k = 3. Errors: kInvalidArgument naming the parameter and the values allowed.
Result<Profile> profile_from_query(std::string_view query);
std::string query_from_profile(const Profile& profile);

}  // namespace eigencast
