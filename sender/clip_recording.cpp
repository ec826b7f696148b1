// SPDX-License-Identifier: MIT
#include "sender/clip_recording.h"

#include <cmath>
#include <ctime>
#include <utility>

#include "common/reconstruction/reconstruct.h"
#include "common/wire/control.h"
#include "sdk/pose_projection.h"
#include "sender/clip_coefficients.h"

namespace eigencast {
namespace {

constexpr TimeUs kCheckpointEveryUs = 1'000'000;

}  // namespace

Result<void> record_key(recording::Writer& writer, KeyWriter& keys, KeyWriter::Coded coded, TimeUs time_us,
                        TimeUs& due_us) {
  const bool is_first = keys.state() == nullptr || due_us == 0;
  const Bytes message = coded.message;
  keys.sent(std::move(coded), message.size());
  // The first pose is a checkpoint alone.
  if (!is_first) {
    if (const auto written = writer.frame(time_us, message); !written) return written;
    if (time_us < due_us) return {};
  }
  due_us = time_us + kCheckpointEveryUs;
  const ChainState& state = *keys.state();
  const auto payload = encode_join(keys.layout(), state);
  if (!payload) return payload.error();
  Envelope envelope;
  envelope.kind = FrameKind::kJoin;
  envelope.flags = state.phase ? Envelope::kRecalled : std::uint8_t{0};
  envelope.bands = state.newer.bands;
  envelope.sequence = keys.newest().sequence;
  envelope.capture_us = keys.newest().capture_us;
  envelope.age_us = state.age_us;
  Bytes join;
  append_envelope(envelope, nullptr, join);
  join.insert(join.end(), payload->begin(), payload->end());
  return writer.checkpoint(time_us, join);
}

Result<void> record_clip(const MotionClip& clip, const BakeResult& baked, const std::string& to,
                         const BakeProgress& progress) {
  const Asset& asset = baked.asset;
  const auto projector = Projector::create(asset);
  if (!projector) return projector.error();
  const auto coefficients = ClipCoefficients::create(clip, *projector, [&](double fraction, std::string_view stage) {
    return !progress || progress(fraction / 2, stage);
  });
  if (!coefficients) return coefficients.error();
  PublisherOptions options;
  options.key_rate_hz = clip.frame_rate_hz();
  const StreamFormat format = format_of(options, asset);
  const Quantiser quantiser = quantiser_for_error(error_bound(options, asset), asset.area, asset.rank);
  KeyWriter keys({CodecKind::kQuantised, format.rows, format.channels, format.band_ends}, quantiser.half_spacing, {});
  keys.begin({});

  const auto now_us = static_cast<std::uint64_t>(std::time(nullptr)) * 1'000'000;
  auto writer = recording::Writer::create(to, {asset.name, "eigencast-sender " EIGENCAST_VERSION, now_us});
  if (!writer) return writer.error();
  for (const AssetObject& chunk : baked.encoded.chunks) {
    if (const auto written = writer->object(0, chunk.id.digest, chunk.bytes); !written) return written;
  }
  const AssetObject& manifest = baked.encoded.manifest;
  if (const auto written = writer->object(0, manifest.id.digest, manifest.bytes); !written) return written;
  control::Announce announce;
  announce.asset = manifest.id.hex();
  announce.format = format;
  announce.key_rate_hz = options.key_rate_hz;
  if (const auto written = writer->announce(0, text_from_control(announce)); !written) return written;

  const std::size_t frames = clip.frame_count();
  TimeUs due_us = 0;
  for (std::size_t frame = 0; frame < frames; ++frame) {
    if (progress && !progress(0.5 + 0.5 * static_cast<double>(frame) / static_cast<double>(frames), "coding poses"))
      return fail(ErrorCode::kCancelled, "stopped at frame " + std::to_string(frame));
    const auto C = coefficients->at(frame);
    if (!C) return C.error();
    auto key = key_from_coefficients(keys.layout(), *C, quantiser.step);
    if (!key) return key.error();
    const auto time_us = static_cast<TimeUs>(std::llround(1e6 * static_cast<double>(frame) / clip.frame_rate_hz()));
    auto coded = keys.code(*std::move(key), time_us);
    if (!coded) return coded.error();
    auto written = record_key(*writer, keys, *std::move(coded), time_us, due_us);
    if (written && frame % 64 == 0) written = writer->flush();
    if (!written) return written;
  }
  return writer->finish();
}

}  // namespace eigencast
