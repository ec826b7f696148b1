// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/codec/key.h"
#include "common/core/clock.h"
#include "common/core/log.h"
#include "common/core/result.h"
#include "common/net/url.h"
#include "common/wire/control.h"

namespace eigencast {

inline constexpr double kDefaultErrorOverDiagonal = 1e-3;

struct PublisherOptions {
  std::string url;  ///< ws://host:port/stream
  CodecKind codec = CodecKind::kQuantised;
  double error = 0;  ///< eps: rms vertex error of quantising, in model units; 0 = the default.
  /// Bits a second that frames, envelopes included, keep to on average, by coarser levels, then fewer bands; 0:
  /// whatever the error bound takes. Only with kQuantised.
  double bitrate = 0;
  /// Poses of a surface that stands still, within kStillOverError of what receivers hold, are left out, but for one
  /// every so often; 0: every pose is sent. No viewer shows a pose further off than that because of it.
  TimeUs still_heartbeat_us = 0;
  bool velocities = false;  ///< Poses come with velocities, which go out beside them: for viewers with scheme=hermite.
  /// Values of each vertex besides its position, at most kMaxScalars: channels 3 to 2 + scalars of the stream. They are
  /// coded within `error`, too: give them a range of about the surface's diagonal.
  std::uint32_t scalars = 0;
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
Result<void> check_options(const PublisherOptions& options, const Asset& asset);

/// Where to, with its credentials. Errors: kInvalidArgument (URL, stream name, credentials).
Result<BrokerUrl> destination(const PublisherOptions& options, const LogSink& log);

/// Or its default for this surface.
double error_bound(const PublisherOptions& options, const Asset& asset);

StreamFormat format_of(const PublisherOptions& options, const Asset& asset);

/// Rows of x, y, z, scalars, and velocities in units of format.velocity_us.
///   C  r x 3;  V  r x 3, per second, or empty;  S  r x as many scalars as the format has
/// Empty where the sizes of C and V do not fit.
std::vector<double> rows_in_format(const StreamFormat& format, std::span<const double> C, std::span<const double> V,
                                   std::span<const double> S);

}  // namespace eigencast
