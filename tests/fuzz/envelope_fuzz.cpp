// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "common/wire/envelope.h"
#include "common/wire/limits.h"

using namespace eigencast;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto frame = parse_frame(ByteView(data, size));
  if (!frame) return 0;
  // A newest key that the frame follows; the bytes themselves choose its time.
  const bool is_next = frame->envelope.kind == FrameKind::kKey;
  ChainClock newest{256U + frame->check - (is_next ? 1U : 0U), std::abs(frame->delay_us), 0};
  newest.age_us = newest.capture_us / (1 + frame->envelope.tag);
  const auto whole = resolved(*frame, &newest, 0);
  if (!whole) return 0;
  const TimeUs at = whole->envelope.capture_us;
  if (at < 0 || at > limits::kMaxTimeUs) std::abort();
  Bytes again;
  append_envelope(whole->envelope, &newest, again);
  again.insert(again.end(), whole->payload.begin(), whole->payload.end());
  if (again != Bytes(data, data + size)) std::abort();
  return 0;
}
