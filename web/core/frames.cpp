// SPDX-License-Identifier: MIT
#include <algorithm>
#include <utility>
#include <vector>

#include "common/wire/envelope.h"
#include "sdk/frame_decoder.h"
#include "web/core/core.h"
#include "web/core/error.h"
#include "web/core/format.h"

struct core_frames {
  eigencast::EnvelopeReader reader;
  eigencast::FrameDecoder decoder;
  std::vector<double> coefficients, next;
  core_pose pose{};
  std::uint64_t unreadable = 0;  ///< Frames that did not reach the decoder.
  core_counts counts{};
};

using namespace eigencast;

int64_t frame_stream_id(const uint8_t* bytes, uint32_t size) {
  const auto frame = parse_frame(ByteView(bytes, size));
  return frame ? int64_t{frame->envelope.stream_id} : -1;
}

core_frames* frames_make() {
  return new core_frames;
}

void frames_free(core_frames* frames) {
  delete frames;
}

int32_t frames_begin(core_frames* frames, uint32_t stream_id, uint32_t tag, uint32_t epoch, const core_format* format) {
  control::StreamInfo info;
  info.stream_id = stream_id;
  info.epoch = epoch;
  if (format != nullptr) {
    info.state = control::StreamInfo::State::kLive;
    auto given = web::format_from(*format);
    if (!given) return web::failed(given.error());
    info.format = *std::move(given);
    info.profile.scheme = static_cast<Profile::Scheme>(format->scheme);
  }
  frames->reader.begin(stream_id, static_cast<std::uint8_t>(tag), epoch);
  frames->decoder.set_stream(info);
  return 0;
}

void frames_restart(core_frames* frames) {
  frames->reader.restart();
  frames->decoder.restart();
}

int32_t frames_remember(core_frames* frames, const uint8_t* asset, const uint8_t* segment, uint32_t size) {
  FrameDecoder& decoder = frames->decoder;
  if (size == 0) {
    decoder.set_memory(std::nullopt);
    return 0;
  }
  AssetDigest of{};
  std::copy_n(asset, of.size(), of.begin());
  auto decoded = decode_segment(decoder.layout(), of, ByteView(segment, size));
  if (!decoded) return web::failed(decoded.error());
  const auto added = decoder.remember(*std::move(decoded));
  return added ? 0 : web::failed(added.error());
}

int32_t frames_decode(core_frames* frames, const uint8_t* bytes, uint32_t size) {
  core_pose& pose = frames->pose = {};
  const auto parsed = parse_frame(ByteView(bytes, size));
  const auto frame = parsed ? frames->reader.read(*parsed) : std::nullopt;
  if (!frame) {
    ++frames->unreadable;
    return parsed ? 0 : web::failed(parsed.error());
  }
  const Envelope& e = frame->envelope;
  pose.sequence = e.sequence;
  pose.capture_us = e.capture_us;
  pose.stream_id = e.stream_id;
  pose.epoch = e.epoch;
  pose.kind = static_cast<std::uint8_t>(e.kind);
  pose.flags = e.flags;
  pose.bands = e.bands.bits;
  pose.at = e.step.at;
  pose.of = e.step.of;
  pose.was_read = 1;
  pose.shown_us = e.is_ahead() && e.step.of != 0 ? shown_us(e) : e.capture_us;
  FrameDecoder& decoder = frames->decoder;
  const auto key = decoder.decode(*frame);
  if (!key) return web::failed(key.error());
  if (*key == nullptr) return 0;
  frames->coefficients = decoder.coefficients(**key);
  pose.coefficients = frames->coefficients.data();
  pose.count = static_cast<std::uint32_t>(frames->coefficients.size());
  pose.integers = (*key)->q.empty() ? nullptr : (*key)->q.data();
  pose.bands = (*key)->bands.bits;  // A step's own envelope has none.
  pose.step = (*key)->step;
  if (const Key* next = decoder.take_ahead()) {
    frames->next = decoder.coefficients(*next);
    pose.next = frames->next.data();
    pose.next_us = decoder.newest_capture_us();
    pose.next_bands = next->bands.bits;
  }
  return 1;
}

const core_pose* frames_pose(const core_frames* frames) {
  return &frames->pose;
}

const core_counts* frames_counts(core_frames* frames) {
  const FrameDecoder::Counts& c = frames->decoder.counts();
  frames->counts = {c.keys, c.synthetic, c.joins, c.rejected + frames->unreadable, c.missed};
  return &frames->counts;
}
