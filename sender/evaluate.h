// SPDX-License-Identifier: MIT
#pragma once

#include "common/asset/asset.h"
#include "common/codec/key.h"
#include "common/core/histogram.h"
#include "common/surface/motion_clip.h"
#include "sender/surface_error.h"

namespace eigencast {

/// What streaming a clip costs and loses, without a network.
struct Evaluation {
  SurfaceError truncation;    ///< Basis alone.
  SurfaceError total;         ///< Basis and codec: what every receiver at full detail sees.
  double quantising_rms = 0;  ///< Area-weighted rms distance of what is received from what was projected, model units.
  std::uint64_t frames = 0;
  std::uint64_t payload_bytes = 0;  ///< Of all keys; the first is a join frame and is not counted.
  std::uint64_t join_bytes = 0;     ///< Of the join frame at the end.
  Histogram encode_ns, decode_ns;

  /// Payload alone, and with envelope (27 bytes) and WebSocket header (4).
  double payload_kbit_per_s(double rate_hz) const;
  double wire_kbit_per_s(double rate_hz) const;
};

/// Projects, codes, decodes and rebuilds every frame of the clip once.
///   eps  vertex error of quantising, model units (see quantiser_for_error); ignored by float codecs
/// Errors: those of the clip; kInternal if a decoder did not give back what the encoder was given.
Result<Evaluation> evaluate(const MotionClip& clip, const Asset& asset, CodecKind codec, double eps);

}  // namespace eigencast
