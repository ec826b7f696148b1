// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "common/core/log.h"
#include "common/core/result.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"

namespace eigencast {

struct SurfaceStreamOptions {
  /// `velocities` are announced where the first pose has some; key_rate_hz is max_rate_hz. Ranges of scalars that are
  /// not known are learnt from the poses: one far outside what is known begins the stream again, without a bake.
  PublisherOptions publisher{};
  BakeOptions bake{};       ///< Without motion, samples, appearance and first.
  std::string cache_dir{};  ///< As of bake().
  bool z_up = false;        ///< Points and velocities come with z up; a stream's y is.
  double scale = 1;         ///< Multiplies them.
  double max_rate_hz = 30;  ///< Of poses that come faster the newest wait; may be infinite.
  bool rebake = true;       ///< Another topology is another surface; else it is an error.
};

/// Streams a surface as a program has it: bakes in a thread at the first pose, and again when the topology is another
/// one by its content, and publishes: with BakeOptions::first until all is there, which then takes over without a gap.
/// send() never waits: it compares and copies; projection, coding and network are the thread's. Poses that come before
/// the basis is up, or without a connection, replace each other; the newest goes out then. Use from one thread. In a
/// process that was forked it refuses, and its end touches nothing.
class SurfaceStream {
 public:
  enum class Sent { kTaken, kBaking, kDisconnected };
  struct Frame {
    std::span<const float> points;  ///< n x 3
    /// Corners of triangles, or of polygons, which are fanned once. Not data() == nullptr but empty: a point cloud.
    std::span<const std::uint32_t> corners;
    std::span<const std::uint64_t> offsets;  ///< As fanned(); empty: triangles.
    bool as_before = false;                  ///< Corners and offsets are those of the last frame.
    std::span<const float> scalars;          ///< n x as many as were announced.
    std::span<const float> velocities;       ///< n x 3, per second, or empty; in all poses of a surface or in none.
    std::optional<double> time_s;            ///< On a clock of the program (default: as they come).
  };
  struct Stats {
    bool baking = false;
    bool loose_faces = false;      ///< See is_triangle_soup().
    std::uint64_t taken = 0;       ///< Poses that send() took.
    std::uint64_t early = 0;       ///< Of those: a newer one went in its place, as of max_rate_hz.
    std::uint64_t superseded = 0;  ///< Of those: likewise, before there was a basis and a connection.
    std::uint64_t bakes = 0;       ///< Surfaces so far.
    std::uint64_t topologies = 0;  ///< Topologies so far; more than bakes: some were gone before they were baked.
    std::uint64_t frames_sent = 0, bytes_sent = 0;
    std::uint64_t dropped = 0;     ///< By the publisher.
    std::uint64_t unusable = 0;    ///< Of those: they cannot be coded.
    Publisher::Stats publisher{};  ///< Of the present surface.
    std::string detail;            ///< For people: what goes on, or why not.
  };

  /// Errors: kInvalidArgument (URL, options).
  static Result<std::unique_ptr<SurfaceStream>> create(SurfaceStreamOptions options, LogSink log = {});
  /// What has been taken is sent if it can be at once; a bake is given up.
  virtual ~SurfaceStream() = default;

  /// Errors: kInvalidArgument (sizes, numbers that are not finite, another topology without `rebake`), kUnsupported (in
  /// another process), those of the bake of this topology.
  virtual Result<Sent> send(const Frame& frame) = 0;
  /// Waits until poses go out; false: not within `timeout`. Errors: kInvalidArgument (nothing was sent yet), kRefused,
  /// those of the bake.
  virtual Result<bool> wait_live(std::chrono::milliseconds timeout) = 0;
  virtual Stats stats() const = 0;
};

}  // namespace eigencast
