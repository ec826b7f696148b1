// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/format/encode.h"
#include "common/codec/key.h"
#include "common/codec/pose_memory.h"
#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/net/websocket.h"
#include "common/wire/control.h"

namespace eigencast {

/// The default of PublisherOptions::error, over the diagonal of the rest box.
inline constexpr double kDefaultErrorOverDiagonal = 1e-3;

/// A value of each vertex besides its position.
struct Scalar {
  std::string name;  ///< See ScalarChannel.
  std::string unit{};
  double low = 0, high = 0;  ///< The range to expect; equal: unknown.
  /// Rms error of quantising, in its unit; 0: a thousandth of the range, or, without one, that of positions.
  double error = 0;
};

/// Whether a publisher remembers poses, so that motion that comes again takes a fraction of the bits.
enum class MemoryUse : std::uint8_t {
  kAuto,  ///< What has come again, as far as that pays (MemoryKeeper).
  kOn,    ///< All that is new, at once: of motion that is known to come again.
  kOff,
};
inline constexpr EnumNames<MemoryUse, 3> kMemoryUseNames{{"auto", "on", "off"}};

/// Whether a stream learns, from its first seconds, columns of what its basis misses (StreamLearner), which viewers
/// fetch, so that poses have less error at as many bits.
enum class LearnUse : std::uint8_t {
  kAuto,  ///< Where it pays (LearningTrial).
  kOn,    ///< Wherever there is something to learn.
  kOff,
};
inline constexpr EnumNames<LearnUse, 3> kLearnUseNames{{"auto", "on", "off"}};

struct PublisherOptions {
  std::string url;  ///< ws://host:port/stream, or with several brokers: see common/net/url.h
  CodecKind codec = CodecKind::kQuantised;
  double error = 0;  ///< eps: rms vertex error of quantising, in model units; 0 = the default.
  /// Bits a second that frames, envelopes included, keep to on average, by coarser levels, then fewer bands; 0:
  /// whatever the error bound takes. Only with kQuantised.
  double bitrate = 0;
  /// Poses of a surface that stands still, within kStillOverError of what receivers hold, are left out, but for one
  /// every so often; 0: every pose is sent. No viewer shows a pose further off than that because of it.
  TimeUs still_heartbeat_us = 0;
  /// Not of float codecs. With a bit rate its segments take at most a fifth of that, beside the frames.
  MemoryUse memory = MemoryUse::kOff;
  LearnUse learn = LearnUse::kOff;  ///< From send_pose()'s poses, of its first asset; see Publisher::learn.
  bool velocities = false;  ///< Poses come with velocities, which go out beside them: for viewers with scheme=hermite.
  std::vector<Scalar> scalars{};               ///< At most kMaxScalars: channels 3 and on of the stream.
  double key_rate_hz = 30;                     ///< Announced; send() may be called at any rate.
  std::optional<std::vector<double>> world{};  ///< Announced, see control::Announce.
  std::size_t max_unsent_bytes =
      64 * 1024;                 ///< A frame is dropped, before it is coded, while more than this is unsent.
  Credentials credentials = {};  ///< Token and trusted authorities; see common/net/url.h.
};

/// The error bound of coding holds on average, not for each pose, so that still surfaces get more.
inline constexpr double kStillOverError = 1.5;

inline constexpr std::uint32_t kMaxScalars = 10;

/// Errors: kInvalidArgument (what cannot be kept to, or not together).
Result<void> check_options(const PublisherOptions& options);

/// Describes each of n vertices, in the source's order.
struct VertexPose {
  std::span<const float> positions;   ///< n x 3
  std::span<const float> velocities;  ///< n x 3, per second; empty unless PublisherOptions::velocities.
  std::span<const float> scalars;     ///< n x as many as PublisherOptions::scalars.
};

/// Publishes one deforming surface to a broker and keeps doing so: uploads the asset where it is missing, announces it,
/// codes and sends keys, and does all of that again after a lost connection, at the URL's next broker. Frames sent
/// meanwhile are dropped, never queued; send() never blocks. Use from one thread; different Publishers are independent.
class Publisher {
 public:
  /// Why a frame was not sent: there is no connection; too much waits for the link; its time is not after the one
  /// before; it cannot be coded.
  enum class DropReason : std::uint8_t { kDisconnected, kBehind, kTime, kUnusable };
  enum class State { kConnecting, kUploading, kLive, kRefused };
  struct Stats {
    State state = State::kConnecting;
    std::string detail;  ///< For people: "uploading 3.1 of 4.2 MB", "broker lost: ..., next try in 400 ms".
    std::uint64_t frames_sent = 0;
    std::uint64_t frames_dropped = 0;
    std::array<std::uint64_t, 4> dropped_for{};  ///< By DropReason; `detail` has the words for the last one.
    std::uint64_t frames_recalled = 0;           ///< Of those sent: predicted from the memory.
    std::uint64_t frames_held = 0;  ///< Not sent because the surface was still (PublisherOptions::still_heartbeat_us).
    std::uint64_t payload_bytes = 0;  ///< Counts the frames sent, envelope included.
    std::uint64_t memory_bytes = 0;   ///< Segments of the memory, as given to the broker: what each viewer fetches.
    std::uint64_t saved_bytes = 0;    ///< What frames would take beyond payload_bytes without a memory.
    std::uint32_t subscribers = 0;
    std::uint64_t reconnects = 0;
    std::uint64_t changes = 0;         ///< Of the asset, by change_to() or learn().
    std::uint32_t learnt_columns = 0;  ///< Of the asset in use, and
    std::uint64_t learnt_bytes = 0;    ///< what each viewer fetches of them.
    bool gave_up = false;              ///< The broker gave the stream to another sender: nothing is tried again.
  };

  /// What has come of remember().
  struct MemoryState {
    std::uint32_t generation = 0;  ///< The broker holds it, and keys are predicted from it; 0: none.
    bool pending = false;          ///< The last call is under way.
    /// Why the broker has not taken what the last call gave: kUnsupported (it keeps none), kTooLarge (its memory is
    /// used up), or that the upload failed. The stream goes on.
    std::optional<Error> refused{};
  };

  /// `asset` must be decode(encoded); both are shared. Errors: kInvalidArgument (URL, stream name, error <= 0).
  static Result<std::unique_ptr<Publisher>> create(PublisherOptions options, std::shared_ptr<const Asset> asset,
                                                   std::shared_ptr<const EncodedAsset> encoded, LogSink log = {});
  /// For callers that have the keys already, as of a recording: send_key() only. `encoded` may be empty but for the
  /// manifest's id: the broker must have the asset then. Errors: kInvalidArgument (URL, stream name, format).
  static Result<std::unique_ptr<Publisher>> create_for_keys(PublisherOptions options, const StreamFormat& format,
                                                            std::shared_ptr<const EncodedAsset> encoded,
                                                            LogSink log = {});
  virtual ~Publisher() = default;

  /// All or some of the bands of create_for_keys()'s format; the rest as send_coefficients().
  ///   coded  the payload it had in another chain, or empty: sent again where it gives the same key; otherwise
  ///          the key is coded exactly
  ///   phase  where in remember()ed poses it was predicted from there, if it was
  virtual SendStatus send_key(Key key, TimeUs capture_us, ByteView coded = {},
                              std::optional<std::uint32_t> phase = {}) = 0;
  /// C: r x 3 row-major; V: their velocities, r x 3, per second, or empty; capture_us: when the pose holds, on the
  /// steady clock, growing. kDropped: also for a time outside 0..kMaxTimeUs, and where V is not as announced.
  virtual SendStatus send_coefficients(std::span<const double> C, TimeUs capture_us,
                                       std::span<const double> V = {}) = 0;
  /// Projects, then sends. Errors: kInvalidArgument, also for the time and for what was not announced or is
  /// missing.
  virtual Result<SendStatus> send_pose(const VertexPose& pose, TimeUs capture_us) = 0;
  /// Sends a pose without velocities and scalars. Errors: as send_pose.
  Result<SendStatus> send_positions(std::span<const float> positions, TimeUs capture_us) {
    return send_pose({positions, {}, {}}, capture_us);
  }
  /// Goes over to another asset of the same surface, whose vertices are in the same order, without a gap: uploads it,
  /// and once viewers hold it, or have had the time, take_change() is true. Poses then go from what was shown to what
  /// the new asset shows within eight keys. Kept up over lost connections; another call replaces it. Takes as long as
  /// setting up a Projector. From any thread. Errors: kInvalidArgument, kNumerical.
  ///   coarser  what the error bound is multiplied by, but for keys predicted from a memory behind another such key;
  ///            without a bit rate
  virtual Result<void> change_to(std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded,
                                 double coarser = 1) = 0;
  /// Learns columns from send_pose()'s poses in the asset that is in use once no change is under way, and changes to
  /// it with them; once. The error bound holds as change_to() says. Not of float codecs. Thread-safe.
  virtual void learn(LearnUse use) = 0;
  /// True once for each change: from now on send_coefficients() takes those of the new asset(). send_pose() calls it.
  /// Use from the thread that sends.
  virtual bool take_change() = 0;
  virtual std::shared_ptr<const Asset> asset() const = 0;  ///< Thread-safe. Null for keys alone.
  /// Tells viewers how much of the asset to change to is done, 0 to 1; once a second at most. Thread-safe.
  virtual void show_progress(double fraction) = 0;
  /// Predicts keys from these poses, the oldest segment first, once the broker holds them; empty: no more. Never waits.
  /// Where those of the call before come first they stay in use meanwhile; a list that begins otherwise costs each
  /// viewer a join. Given to the broker again after a lost connection. Errors: kInvalidArgument (a float codec, another
  /// layout), kTooLarge (PoseMemory, limits::kMaxMemorySegments), kRefused (a call is under way).
  ///   segments  of the manifest's id (encode_segment)
  virtual Result<void> remember(std::vector<CodedSegment> segments) = 0;
  virtual MemoryState memory() const = 0;               ///< Thread-safe.
  virtual std::vector<double> as_received() const = 0;  ///< What receivers hold (r x 3); empty: nothing yet.
  virtual State state() const = 0;  ///< That of stats(), without waiting for a pose that is being coded. Thread-safe.
  virtual Stats stats() const = 0;  ///< Thread-safe.
};

}  // namespace eigencast
