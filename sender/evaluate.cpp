// SPDX-License-Identifier: MIT
#include "sender/evaluate.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>

#include "common/codec/chain.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/checks/jumps.h"
#include "common/surface/vector.h"
#include "common/wire/envelope.h"
#include "sender/order_check.h"

namespace eigencast {
namespace {

constexpr TimeUs kKeyInterval = 33'333;
constexpr std::size_t kStillPoses = 60;  // two seconds

/// With the envelope of an even stream, and WebSocket's header from server to client.
std::size_t wire_bytes(std::size_t payload) {
  const std::size_t message = payload + Envelope::kKeyBytes;
  return message + (message < 126 ? 2 : message < 65'536 ? 4 : 10);
}

/// What `act` gives; how long that took goes to `ns`.
template <typename Act>
auto timed(Histogram& ns, Act&& act) {
  const auto start = std::chrono::steady_clock::now();
  auto result = act();
  ns.add(std::chrono::nanoseconds(std::chrono::steady_clock::now() - start).count());
  return result;
}

/// Returns the payload's bytes; 0 for the first key, which joins. The newer key of the state is then what was decoded.
Result<std::size_t> code_key(const CoefficientLayout& layout, const Key& key, std::uint8_t half_spacing,
                             std::optional<ChainState>& state, Evaluation& result) {
  if (!state) {
    state = advanced(std::nullopt, key, 0);
    return std::size_t{0};
  }
  auto coded = timed(result.encode_ns, [&] { return encode_key(layout, *state, key, half_spacing); });
  if (!coded) return coded.error();
  const auto decoded =
      timed(result.decode_ns, [&] { return decode_key(layout, layout.all_bands(), *state, coded->payload); });
  if (!decoded) return decoded.error();
  if (*decoded != coded->key) return fail(ErrorCode::kInternal, "a decoded key differs from the one that was coded");
  state = advanced(std::move(state), std::move(coded->key), kKeyInterval);
  return coded->payload.size();
}

Result<StillPose> still_pose(const CoefficientLayout& layout, const Key& key, std::uint8_t half_spacing,
                             std::optional<ChainState> state, const Asset& asset) {
  Evaluation uncounted;
  StillPose still;
  std::vector<double> before = coefficients_from_key(layout, state->newer);
  for (std::size_t pose = 1; pose <= kStillPoses; ++pose) {
    const auto coded = code_key(layout, key, half_spacing, state, uncounted);
    if (!coded) return coded.error();
    std::vector<double> now = coefficients_from_key(layout, state->newer);
    const double moved = surface_distance(before, now, asset.area) / asset.diagonal();
    if (moved > 0) still.settles_after = pose;
    if (2 * pose > kStillPoses) still.moves = std::max(still.moves, moved);
    before = std::move(now);
  }
  return still;
}

/// Returns them in the asset's order and space.
std::vector<Vec3> rows_of(const Asset& asset, std::span<const Vec3> source) {
  std::vector<Vec3> rows;
  for (const std::uint32_t vertex : asset.source_vertex) rows.push_back(source[vertex] - asset.origin);
  return rows;
}

class Sums {
 public:
  Sums(const Asset& asset, const MotionClip& clip, const EvaluateOptions& options)
      : asset_(asset),
        rebuilder_(asset),
        truncation_(asset.diagonal()),
        total_(asset.diagonal()),
        surface_(rows_of(asset, clip.rest().positions), asset.faces) {
    const std::vector<Vec3> rest = rows_of(asset, clip.rest().positions);
    for (const double fraction : options.levels) levels_.emplace_back(asset, fraction, rest);
  }
  void add(std::span<const Vec3> pose, std::span<const double> sent, std::span<const double> received) {
    const std::vector<Vec3> truth = rows_of(asset_, pose);
    truncation_.add(truth, rebuilder_.rebuild_rows(sent, 3));
    const std::vector<Vec3> rebuilt = rebuilder_.rebuild_rows(received, 3);
    rms_by_frame_.push_back(total_.add(truth, rebuilt));
    surface_.move_to(truth);
    for (LevelErrorSum& level : levels_) level.add(truth, surface_, rebuilt);
  }
  void state(Evaluation& result) {
    result.truncation = truncation_.result();
    result.total = total_.result();
    for (const LevelErrorSum& level : levels_) result.levels.push_back(level.result());
    result.rms_by_frame = std::move(rms_by_frame_);
  }

 private:
  const Asset& asset_;
  SourceRebuilder rebuilder_;
  SurfaceErrorSum truncation_, total_;
  SurfaceDistance surface_;
  std::vector<LevelErrorSum> levels_;
  std::vector<double> rms_by_frame_;
};

}  // namespace

double Evaluation::payload_kbit_per_s(double rate_hz) const {
  return frames == 0 ? 0 : static_cast<double>(payload_bytes) / static_cast<double>(frames) * 8e-3 * rate_hz;
}

double Evaluation::wire_kbit_per_s(double rate_hz) const {
  return frames == 0 ? 0 : static_cast<double>(wire_bytes) / static_cast<double>(frames) * 8e-3 * rate_hz;
}

double eps_from_step(const Asset& asset, double step) {
  return step * asset.diagonal() / 2 * std::sqrt(static_cast<double>(asset.rank));
}

Result<Evaluation> evaluate(const MotionClip& clip, const Asset& asset, const EvaluateOptions& options,
                            const BakeProgress& progress) {
  const auto projector = Projector::create(asset);
  if (!projector) return projector.error();
  const CoefficientLayout layout{options.codec, asset.rank, 3, asset.band_ends};
  const Quantiser quantiser = quantiser_for_error(options.eps, asset.area, asset.rank);

  Evaluation result;
  Sums sums(asset, clip, options);
  std::optional<ChainState> state;
  double quantising = 0;
  JumpFinder jumps(clip.rest());
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    const double done = static_cast<double>(frame) / static_cast<double>(clip.frame_count());
    if (progress && !progress(done, "evaluating")) return fail(ErrorCode::kCancelled, "stopped while evaluating");
    const auto truth = clip.pose(frame);
    if (!truth) return truth.error();
    jumps.add(*truth);
    const auto C =
        projector->coefficients_from_positions(std::span<const double>(truth->front().data(), 3 * truth->size()));
    if (!C) return in_context("frame " + std::to_string(frame), C.error());
    const auto key = key_from_coefficients(layout, *C, quantiser.step);
    if (!key) return key.error();
    const auto coded = code_key(layout, *key, quantiser.half_spacing, state, result);
    if (!coded) return coded.error();
    result.payload_bytes += *coded;
    if (frame > 0) {
      ++result.frames;
      result.wire_bytes += wire_bytes(*coded);
    }
    const std::vector<double> received = coefficients_from_key(layout, state->newer);
    const double distance = surface_distance(*C, received, asset.area);
    quantising += distance * distance;
    sums.add(*truth, *C, received);
    if (frame == clip.frame_count() / 2) {
      const auto still = still_pose(layout, *key, quantiser.half_spacing, state, asset);
      if (!still) return still.error();
      result.still = *still;
    }
  }
  if (state) {
    const auto join = encode_join(layout, *state);
    if (!join) return join.error();
    result.join_bytes = join->size();
  }
  result.quantising_rms = std::sqrt(quantising / static_cast<double>(std::max<std::size_t>(clip.frame_count(), 1)));
  sums.state(result);
  if (const auto accepted = accept_order(jumps.order(), options.any_order); !accepted) return accepted.error();
  result.findings = jumps.findings();
  return result;
}

}  // namespace eigencast
