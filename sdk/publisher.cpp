// SPDX-License-Identifier: MIT
#include "sdk/publisher.h"

#include <cmath>
#include <utility>

#include "sdk/broker_publisher.h"

namespace eigencast {

namespace {

template <typename... Arguments>
std::unique_ptr<Publisher> started(Arguments&&... arguments) {
  auto made = std::make_unique<BrokerPublisher>(std::forward<Arguments>(arguments)...);
  made->start();
  return made;
}

/// Also of what this surface does not do with.
Result<void> check_options(const PublisherOptions& options, const Asset& asset) {
  if (auto usable = check_options(options); !usable) return usable;
  if (options.error == 0 && !(asset.diagonal() > 0))
    return fail(ErrorCode::kInvalidArgument,
                "the rest pose has no extent, so the error bound has no default: give one");
  return {};
}

}  // namespace

Result<void> check_options(const PublisherOptions& options) {
  if (!std::isfinite(options.error) || options.error < 0)
    return fail(ErrorCode::kInvalidArgument,
                "the error bound must be a positive length in model units, or 0 for the default");
  if (!std::isfinite(options.bitrate) || options.bitrate < 0 || options.still_heartbeat_us < 0)
    return fail(ErrorCode::kInvalidArgument, "bit rate and heartbeat must be positive, or 0 for none");
  if (options.scalars.size() > kMaxScalars)
    return fail(ErrorCode::kInvalidArgument, "a stream carries at most " + std::to_string(kMaxScalars) + " scalars");
  if (!options.scalars.empty() && options.still_heartbeat_us > 0)
    return fail(ErrorCode::kInvalidArgument,
                "a publisher of scalars cannot leave out still poses: they may change while the surface stands still");
  if (options.velocities && options.still_heartbeat_us > 0)
    return fail(ErrorCode::kInvalidArgument,
                "a publisher of velocities cannot leave out still poses: a held pose would go on with its velocities");
  if (options.bitrate > 0 && options.codec != CodecKind::kQuantised)
    return fail(ErrorCode::kInvalidArgument, "only the quantised codec can keep to a bit rate");
  return {};
}

Result<std::unique_ptr<Publisher>> Publisher::create(PublisherOptions options, std::shared_ptr<const Asset> asset,
                                                     std::shared_ptr<const EncodedAsset> encoded, LogSink log) {
  if (!asset || !encoded || !asset->complete())
    return fail(ErrorCode::kInvalidArgument, "a publisher needs a complete asset");
  auto url = stream_url(options.url, options.credentials, log);
  if (!url) return url.error();
  if (auto usable = check_options(options, *asset); !usable) return usable.error();
  StreamFormat format = format_of(options, *asset);
  if (auto usable = check_format(format); !usable) return usable.error();
  const CodecKind codec = options.codec;
  auto sending = std::make_unique<Sending>(options, codec, std::move(format), std::move(asset), std::move(encoded));
  return started(std::move(options), std::move(*url), std::move(sending), std::move(log));
}

Result<std::unique_ptr<Publisher>> Publisher::create_for_keys(PublisherOptions options, const StreamFormat& format,
                                                              std::shared_ptr<const EncodedAsset> encoded,
                                                              LogSink log) {
  if (!encoded) return fail(ErrorCode::kInvalidArgument, "a publisher needs to know its asset");
  if (auto usable = check_format(format); !usable) return usable.error();
  const auto codec = codec_from_name(format.codec);
  if (!codec) return codec.error();
  auto url = stream_url(options.url, options.credentials, log);
  if (!url) return url.error();
  auto sending = std::make_unique<Sending>(options, *codec, format, nullptr, std::move(encoded));
  return started(std::move(options), std::move(*url), std::move(sending), std::move(log));
}

}  // namespace eigencast
