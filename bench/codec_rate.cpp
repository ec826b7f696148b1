// SPDX-License-Identifier: MIT
//
// codec_rate CLIP [EPS_OVER_DIAGONAL [KEYS_PER_SECOND [RANK]]]: bakes the first frame of a clip, codes the clip as a
// sender and a broker would, and reports bits per kind of frame and band, the cost of tripling, Karni-Gotsman errors,
// and times.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <numeric>

#include "common/codec/chain.h"
#include "common/core/histogram.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "common/wire/envelope.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sender/surface_error.h"

namespace {

using namespace eigencast;

constexpr double kSyntheticSpacing = 2.5;  // Over that of keys; as broker/relay/feed.cpp.

template <typename T>
T value_or_exit(Result<T> result) {
  if (result) return *std::move(result);
  std::fprintf(stderr, "codec_rate: %s\n", result.error().message.c_str());
  std::exit(1);
}

/// The result of one call, whose microseconds are added to `times`.
template <typename Work>
auto timed(std::vector<double>& times, Work&& work) {
  using Clock = std::chrono::steady_clock;
  const auto begin = Clock::now();
  auto result = value_or_exit(work());
  times.push_back(std::chrono::duration<double, std::micro>(Clock::now() - begin).count());
  return result;
}

/// Bytes of a frame's envelope and of the WebSocket header before it.
std::size_t bytes_around(std::size_t payload) {
  return Envelope::kKeyBytes + (payload + Envelope::kKeyBytes < 126 ? 2 : 4);
}

/// Bytes, errors and times of all frames of one kind; each frame is coded once, as in a stream.
struct Tally {
  std::size_t frames = 0, bytes = 0, on_the_wire = 0;
  std::vector<std::size_t> band_bytes;
  double square = 0;  ///< Sums surface distances between target and decoded pose.
  std::vector<double> encode_us, decode_us;

  void add(const CoefficientLayout& layout, const Asset& asset, const ChainState& state, const Key& target,
           const Bytes& payload) {
    const Key decoded = timed(decode_us, [&] { return decode_key(layout, target.bands, state, payload); });
    ++frames;
    bytes += payload.size();
    on_the_wire += payload.size() + bytes_around(payload.size());
    band_bytes.resize(layout.band_ends.size());
    for (std::size_t band = 0; band < band_bytes.size(); ++band) {
      const BandMask keep = static_cast<std::uint8_t>(1u << band);
      band_bytes[band] += value_or_exit(cut_bands(layout, false, target.bands, keep, payload)).size() - 1;
    }
    const double distance =
        surface_distance(coefficients_from_key(layout, target), coefficients_from_key(layout, decoded), asset.area);
    square += distance * distance;
  }

  void print(const char* name, double frames_per_second, double diagonal) const {
    const auto n = static_cast<double>(std::max<std::size_t>(frames, 1));
    std::printf(
        "%-10s %6.1f bytes/frame %6.1f kbit/s payload %6.1f on the wire; error %.2e diag; encode %5.1f us decode %5.1f "
        "us; bytes by band",
        name, static_cast<double>(bytes) / n, static_cast<double>(bytes) / n * 8e-3 * frames_per_second,
        static_cast<double>(on_the_wire) / n * 8e-3 * frames_per_second, std::sqrt(square / n) / diagonal,
        median(encode_us), median(decode_us));
    for (const std::size_t band : band_bytes) std::printf(" %.1f", static_cast<double>(band) / n);
    std::printf("\n");
  }
};

void run(const MotionClip& clip, double eps, double keys_per_second, int rank) {
  BakeOptions options;
  options.rank = rank;
  const BakeResult baked = value_or_exit(bake(clip.rest(), options, {}));
  const Asset& asset = baked.asset;
  const Projector projector = value_or_exit(Projector::create(asset));
  const CoefficientLayout layout{CodecKind::kQuantised, asset.rank, 3, asset.band_ends};
  const Quantiser quantiser = quantiser_for_error(eps * asset.diagonal(), asset.area, asset.rank);
  const auto coarse = static_cast<std::uint8_t>(std::min(63.0, kSyntheticSpacing * quantiser.half_spacing));

  Tally keys, synthetics;
  std::size_t join_bytes = 0;
  SurfaceErrorSum truncation(asset.diagonal()), total(asset.diagonal());
  SourceRebuilder rebuilder(asset);
  std::optional<ChainState> state;
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    const auto truth = value_or_exit(clip.pose(frame));
    std::vector<double> flat;
    for (const Vec3& vertex : truth) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto C = value_or_exit(projector.coefficients_from_positions(std::span<const double>(flat)));
    const Key target = value_or_exit(key_from_coefficients(layout, C, quantiser.step));
    Key held = target;
    if (state) {
      CodedKey coded =
          timed(keys.encode_us, [&] { return encode_key(layout, *state, target, quantiser.half_spacing); });
      keys.add(layout, asset, *state, target, coded.payload);
      for (std::uint32_t at = 1; at < 3; ++at) {
        const Key pose = value_or_exit(interpolate_keys(layout, state->newer, coded.key, at, 3));
        synthetics.add(layout, asset, *state, pose,
                       timed(synthetics.encode_us, [&] { return encode_pose(layout, *state, pose, coarse); }));
      }
      held = std::move(coded.key);
    }
    truncation.add(truth, rebuilder.rebuild(C, 3));
    total.add(truth, rebuilder.rebuild(coefficients_from_key(layout, held), 3));
    state = advanced(std::move(state), std::move(held), state ? 33'333 : 0);
    join_bytes += value_or_exit(encode_join(layout, *state)).size();
  }

  std::printf("%s: r %u, %zu frames, eps %.2e of the diagonal, step %d, m %d\n", clip.name().c_str(), asset.rank,
              clip.frame_count(), eps, int{quantiser.step}, int{quantiser.half_spacing});
  std::printf("KG %.3f %% basis alone, %.3f %% in all\n", truncation.result().kg_percent, total.result().kg_percent);
  keys.print("key", keys_per_second, asset.diagonal());
  synthetics.print("synthetic", 2 * keys_per_second, asset.diagonal());
  const auto k = static_cast<double>(keys.bytes), wire = static_cast<double>(keys.on_the_wire),
             n = static_cast<double>(keys.frames);
  std::printf("join       %6.1f bytes\n", static_cast<double>(join_bytes) / (n + 1));
  std::printf(
      "x3 over raw, payload: full %.2f, compact 1.00;  with envelope and WebSocket header: full %.2f, compact %.2f\n",
      (k + static_cast<double>(synthetics.bytes)) / k, (wire + static_cast<double>(synthetics.on_the_wire)) / wire,
      (wire + static_cast<double>(3 * bytes_around(0)) * n) / wire);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: codec_rate CLIP [EPS_OVER_DIAGONAL [KEYS_PER_SECOND [RANK]]]\n");
    return 2;
  }
  const std::filesystem::path path(argv[1]);
  const bool arrays = std::filesystem::exists(path / "vertices.npy");
  const auto clip = value_or_exit(open_clip(arrays ? (path / "vertices.npy").string() : path.string()));
  run(*clip, argc > 2 ? std::atof(argv[2]) : kDefaultErrorOverDiagonal, argc > 3 ? std::atof(argv[3]) : 30,
      argc > 4 ? std::atoi(argv[4]) : 200);
  return 0;
}
