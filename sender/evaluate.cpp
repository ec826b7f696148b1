// SPDX-License-Identifier: MIT
#include "sender/evaluate.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>

#include "common/codec/chain.h"
#include "common/reconstruction/reconstruct.h"
#include "common/wire/envelope.h"

namespace eigencast {
namespace {

constexpr std::size_t kWebSocketHeaderBytes = 4;  // server to client, payload of 126 to 65,535 bytes

class Stopwatch {
 public:
  std::int64_t ns() const {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

/// Codes a key against the state, decodes it again, counts, and advances the state, whose newer key it then is.
Result<void> count_key(const CoefficientLayout& layout, const Key& key, std::uint8_t half_spacing,
                       std::optional<ChainState>& state, Evaluation& result) {
  if (!state) {
    state = advanced(std::nullopt, key, 0);
    return {};
  }
  const Stopwatch encoding;
  auto coded = encode_key(layout, *state, key, half_spacing);
  result.encode_ns.add(encoding.ns());
  if (!coded) return coded.error();
  const Stopwatch decoding;
  const auto decoded = decode_key(layout, layout.all_bands(), *state, coded->payload);
  result.decode_ns.add(decoding.ns());
  if (!decoded) return decoded.error();
  if (*decoded != coded->key) return fail(ErrorCode::kInternal, "a decoded key differs from the one that was coded");
  result.payload_bytes += coded->payload.size();
  ++result.frames;
  state = advanced(std::move(state), std::move(coded->key), 33'333);
  return {};
}

}  // namespace

double Evaluation::payload_kbit_per_s(double rate_hz) const {
  return frames == 0 ? 0 : static_cast<double>(payload_bytes) / static_cast<double>(frames) * 8e-3 * rate_hz;
}

double Evaluation::wire_kbit_per_s(double rate_hz) const {
  return payload_kbit_per_s(rate_hz) + static_cast<double>(Envelope::kBytes + kWebSocketHeaderBytes) * 8e-3 * rate_hz;
}

Result<Evaluation> evaluate(const MotionClip& clip, const Asset& asset, CodecKind codec, double eps) {
  const auto projector = Projector::create(asset);
  if (!projector) return projector.error();
  const CoefficientLayout layout{codec, asset.rank, 3, asset.band_ends};
  const Quantiser quantiser = quantiser_for_error(eps, asset.area, asset.rank);

  Evaluation result;
  SurfaceErrorSum truncation(asset.diagonal()), total(asset.diagonal());
  SourceRebuilder rebuilder(asset);
  std::optional<ChainState> state;
  double quantising = 0;
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    const auto truth = clip.pose(frame);
    if (!truth) return truth.error();
    std::vector<double> flat;
    flat.reserve(truth->size() * 3);
    for (const Vec3& vertex : *truth) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto C = projector->coefficients_from_positions(std::span<const double>(flat));
    if (!C) return in_context("frame " + std::to_string(frame), C.error());
    const auto key = key_from_coefficients(layout, *C, quantiser.step);
    if (!key) return key.error();
    if (const auto counted = count_key(layout, *key, quantiser.half_spacing, state, result); !counted)
      return counted.error();
    truncation.add(*truth, rebuilder.rebuild(*C, 3));
    const std::vector<double> received = coefficients_from_key(layout, state->newer);
    const double distance = surface_distance(*C, received, asset.area);
    quantising += distance * distance;
    total.add(*truth, rebuilder.rebuild(received, 3));
  }
  if (state) {
    const auto join = encode_join(layout, *state);
    if (!join) return join.error();
    result.join_bytes = join->size();
  }
  result.quantising_rms = std::sqrt(quantising / static_cast<double>(std::max<std::size_t>(clip.frame_count(), 1)));
  result.truncation = truncation.result();
  result.total = total.result();
  return result;
}

}  // namespace eigencast
