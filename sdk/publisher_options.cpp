// SPDX-License-Identifier: MIT
#include "sdk/publisher_options.h"

#include <algorithm>
#include <cmath>

#include "common/wire/limits.h"

namespace eigencast {

namespace {

/// A quarter of a key interval: so coarse that velocities cost few bits, so fine that their rounding moves a pose
/// between two keys (by at most 4/27 of an interval's movement) less than that of the keys does.
std::uint32_t velocity_unit(double key_rate_hz) {
  const double us = key_rate_hz > 0 ? 1e6 / key_rate_hz / 4 : 0;
  return static_cast<std::uint32_t>(std::clamp(us, 1000.0, static_cast<double>(limits::kMaxVelocityUs)));
}

}  // namespace

Result<void> check_options(const PublisherOptions& options) {
  if (!std::isfinite(options.error) || options.error < 0)
    return fail(ErrorCode::kInvalidArgument,
                "the error bound must be a positive length in model units, or 0 for the default");
  if (!std::isfinite(options.bitrate) || options.bitrate < 0 || options.still_heartbeat_us < 0)
    return fail(ErrorCode::kInvalidArgument, "bit rate and heartbeat must be positive, or 0 for none");
  if (options.scalars > kMaxScalars)
    return fail(ErrorCode::kInvalidArgument, "a stream carries at most " + std::to_string(kMaxScalars) + " scalars");
  if (options.scalars > 0 && options.still_heartbeat_us > 0)
    return fail(ErrorCode::kInvalidArgument,
                "a publisher of scalars cannot leave out still poses: they may change while the surface stands still");
  if (options.velocities && options.still_heartbeat_us > 0)
    return fail(ErrorCode::kInvalidArgument,
                "a publisher of velocities cannot leave out still poses: a held pose would go on with its velocities");
  if (options.bitrate > 0 && options.codec != CodecKind::kQuantised)
    return fail(ErrorCode::kInvalidArgument, "only the quantised codec can keep to a bit rate");
  return {};
}

Result<void> check_options(const PublisherOptions& options, const Asset& asset) {
  if (auto usable = check_options(options); !usable) return usable;
  if (options.error == 0 && !(asset.diagonal() > 0))
    return fail(ErrorCode::kInvalidArgument,
                "the rest pose has no extent, so the error bound has no default: give one");
  return {};
}

Result<BrokerUrl> destination(const PublisherOptions& options, const LogSink& log) {
  auto url = parse_broker_url(options.url);
  if (!url) return url;
  if (const auto good = complete_credentials(*url, options.credentials, log); !good) return good.error();
  if (auto name = check_stream_name(url->stream); !name)
    return in_context("stream name in \"" + url->shown() + "\"", name.error());
  return url;
}

double error_bound(const PublisherOptions& options, const Asset& asset) {
  return options.error > 0 ? options.error : kDefaultErrorOverDiagonal * asset.diagonal();
}

StreamFormat format_of(const PublisherOptions& options, const Asset& asset) {
  StreamFormat format{asset.rank, 3U + options.scalars, asset.band_ends, std::string(name_of(options.codec))};
  if (options.velocities) {
    format.channels += 3;
    format.velocity_channels = 3;
    format.velocity_us = velocity_unit(options.key_rate_hz);
  }
  return format;
}

std::vector<double> rows_in_format(const StreamFormat& format, std::span<const double> C, std::span<const double> V,
                                   std::span<const double> S) {
  const std::size_t r = format.rows, c = format.channels, s = c - 3 - format.velocity_channels;
  if (C.size() != 3 * r || (!V.empty() && V.size() != C.size())) return {};
  std::vector<double> all(r * c);
  const double unit_s = format.velocity_us * 1e-6;
  for (std::size_t row = 0; row < r; ++row) {
    double* to = &all[row * c];
    std::copy_n(&C[3 * row], 3, to);
    for (std::size_t k = 0; k < s; ++k) to[3 + k] = S[row * s + k];
    for (std::size_t axis = 0; !V.empty() && axis < 3; ++axis) to[3 + s + axis] = V[3 * row + axis] * unit_s;
  }
  return all;
}

}  // namespace eigencast
