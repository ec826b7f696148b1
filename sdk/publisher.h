// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/asset/format/encode.h"
#include "common/codec/key.h"
#include "common/core/log.h"
#include "common/net/websocket.h"
#include "common/wire/control.h"
#include "sdk/publisher_options.h"

namespace eigencast {

/// Of each of n vertices, in the source's order.
struct VertexPose {
  std::span<const float> positions;   ///< n x 3
  std::span<const float> velocities;  ///< n x 3, per second; empty unless PublisherOptions::velocities.
  std::span<const float> scalars;     ///< n x PublisherOptions::scalars
};

/// Publishes one deforming surface to a broker and keeps doing so: uploads the asset where it is missing, announces it,
/// codes and sends keys, and does all of that again after a lost connection. Frames sent meanwhile are dropped, never
/// queued; send() never blocks. Use from one thread; different Publishers are independent.
class Publisher final {
 public:
  enum class State { kConnecting, kUploading, kLive, kRefused };
  struct Stats {
    State state = State::kConnecting;
    std::string detail;  ///< For people: "uploading 3.1 of 4.2 MB", "broker lost: ..., next try in 400 ms".
    std::uint64_t frames_sent = 0;
    std::uint64_t frames_dropped = 0;
    std::uint64_t frames_held = 0;  ///< Not sent because the surface was still (PublisherOptions::still_heartbeat_us).
    std::uint64_t payload_bytes = 0;  ///< Of the frames sent, envelope included.
    std::uint32_t subscribers = 0;
    std::uint64_t reconnects = 0;
    bool gave_up = false;  ///< The broker gave the stream to another sender: nothing is tried again.
  };

  /// `asset` must be decode(encoded); both are shared. Errors: kInvalidArgument (URL, stream name, error <= 0).
  static Result<std::unique_ptr<Publisher>> create(PublisherOptions options, std::shared_ptr<const Asset> asset,
                                                   std::shared_ptr<const EncodedAsset> encoded, LogSink log = {});
  /// For callers that have the keys already, as of a recording: send_key() only. `encoded` may be empty but for the
  /// manifest's id: the broker must have the asset then. Errors: kInvalidArgument (URL, stream name, format).
  static Result<std::unique_ptr<Publisher>> create_for_keys(PublisherOptions options, const StreamFormat& format,
                                                            std::shared_ptr<const EncodedAsset> encoded,
                                                            LogSink log = {});
  ~Publisher();

  /// All or some of the bands of create_for_keys()'s format; the rest as send_coefficients().
  ///   coded  the payload it had in another chain, or empty: sent again where it gives the same key
  SendStatus send_key(Key key, TimeUs capture_us, ByteView coded = {});
  /// C: r x 3 row-major; capture_us: when the pose holds, on the steady clock, growing; outside 0..kMaxTimeUs:
  /// kDropped.
  SendStatus send_coefficients(std::span<const double> C, TimeUs capture_us);
  /// The same with V: their velocities, r x 3, per second. REQUIRES: PublisherOptions::velocities; without them a
  /// publisher of velocities sends none (kDropped).
  SendStatus send_coefficients(std::span<const double> C, std::span<const double> V, TimeUs capture_us);
  /// positions: n x 3 in the source's vertex order. Projects, then as above. Errors: kInvalidArgument (also for the
  /// time).
  Result<SendStatus> send_positions(std::span<const float> positions, TimeUs capture_us);
  /// The same with the vertices' velocities, n x 3, per second. Errors: kInvalidArgument also without
  /// PublisherOptions::velocities.
  Result<SendStatus> send_positions(std::span<const float> positions, std::span<const float> velocities,
                                    TimeUs capture_us);
  /// The same with all that was announced. Errors: kInvalidArgument, also for what was not, or is missing.
  Result<SendStatus> send_pose(const VertexPose& pose, TimeUs capture_us);
  /// What receivers decode (r x 3) for the last key that was sent; empty before the first of a connection.
  std::vector<double> as_received() const;
  Stats stats() const;  ///< Thread-safe.

 private:
  class Impl;
  explicit Publisher(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace eigencast
