// SPDX-License-Identifier: MIT
#include "web/core/writer.h"

#include <cmath>
#include <utility>

#include "common/wire/limits.h"
#include "sdk/key_writer.h"
#include "web/core/error.h"
#include "web/core/format.h"

using namespace eigencast;

struct core_writer {
  KeyWriter writer;
  std::uint8_t step = 0;
  Bytes frame;
};

core_writer* writer_make(const core_format* given, double error, double area) {
  const auto format = web::format_from(*given);
  if (!format) return web::no(format.error());
  if (!(error > 0 && area > 0 && std::isfinite(error / area)))
    return web::no(fail(ErrorCode::kInvalidArgument, "the error and the surface's area must be positive"));
  const CodecKind codec = *codec_from_name(format->codec);
  const Quantiser quantiser =
      codec == CodecKind::kQuantised ? quantiser_for_error(error, area, format->rows) : Quantiser{};
  const CoefficientLayout layout{codec, format->rows, format->channels, format->band_ends};
  return new core_writer{KeyWriter(layout, quantiser.half_spacing, std::nullopt), quantiser.step, {}};
}

void writer_free(core_writer* writer) {
  delete writer;
}

void writer_begin(core_writer* writer, uint32_t stream_id, uint32_t tag) {
  control::Announced announced;
  announced.stream_id = stream_id;
  announced.tag = static_cast<std::uint8_t>(tag);
  writer->writer.begin(announced);
}

int32_t writer_frame(core_writer* writer, const double* coefficients, uint32_t count, int64_t capture_us) {
  if (capture_us < 0 || capture_us > limits::kMaxTimeUs || !writer->writer.may_follow(capture_us))
    return web::failed(fail(ErrorCode::kInvalidArgument, "a pose must hold after the one before"));
  auto key = key_from_coefficients(writer->writer.layout(), {coefficients, count}, writer->step);
  if (!key) return web::failed(key.error());
  auto coded = writer->writer.code(*std::move(key), capture_us);
  if (!coded) return web::failed(coded.error());
  writer->frame = coded->message;
  writer->writer.sent(*std::move(coded), writer->frame.size());
  return static_cast<std::int32_t>(writer->frame.size());
}

const uint8_t* writer_bytes(const core_writer* writer) {
  return writer->frame.data();
}
