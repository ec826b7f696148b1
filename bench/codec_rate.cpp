// SPDX-License-Identifier: MIT
//
// codec_rate CLIP [EPS_OVER_DIAGONAL [KEYS_PER_SECOND [RANK]]]: bakes the first frame of a clip, codes the clip as a
// sender and a broker would, and reports bits per kind of frame and band, the cost of tripling, Karni-Gotsman errors,
// and times.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <filesystem>
#include <numeric>

#include "common/codec/chain.h"
#include "common/core/histogram.h"
#include "common/motion/curve.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "common/wire/envelope.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sender/surface_error.h"

namespace {

using namespace eigencast;

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
  Tally keys;
  std::size_t poses = 0, residuals = 0, first_residuals = 0, residual_bytes = 0;
  std::vector<double> residual_us;
  std::deque<Key> last;  // The four keys that a curve passes through.
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
      held = std::move(coded.key);
    }
    last.push_back(held);
    if (last.size() > 4) last.pop_front();
    for (std::uint32_t at = 1; last.size() == 4 && at < 3; ++at) {
      const CurveWeights w = catmull_rom_weights(0, 3, 6, 9, 3 + at);
      const auto rest = timed(residual_us, [&]() -> Result<CodedResidual> {
        const Key base = value_or_exit(interpolate_keys(layout, last[1], last[2], at, 3));
        const std::array<const Key*, 4> four{&last[0], &last[1], &last[2], &last[3]};
        const std::array<double, 4> weights{w.before, w.from, w.to, w.after};
        return encode_residual(layout, base, value_or_exit(blend_keys(layout, four, weights, 2)),
                               quantiser.half_spacing);
      });
      ++poses;
      residuals += rest.bands.empty() ? 0 : 1;
      first_residuals += at > 1 || rest.bands.empty() ? 0 : 1;
      residual_bytes += rest.payload.size();
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
  const auto wire = static_cast<double>(keys.on_the_wire), n = static_cast<double>(keys.frames);
  std::printf("join       %6.1f bytes\n", static_cast<double>(join_bytes) / (n + 1));
  // A step is five bytes and two of WebSocket; a key shows the first one for a byte, unless that has a residual.
  const double of_each = 1 / static_cast<double>(std::max<std::size_t>(poses, 1));
  const double each = static_cast<double>(residual_bytes + residuals) * of_each;
  const double linear = wire + (1 + 2 * 7) * n;
  const double curved = linear + 2 * n * (7 * static_cast<double>(first_residuals) * of_each + each);
  std::printf("residual   %6.1f bytes/pose, %zu of %zu poses have one; %5.1f us to make and encode\n", each, residuals,
              poses, residual_us.empty() ? 0 : median(residual_us));
  std::printf("x3 over raw, with headers: linear %.2f (+%.1f kbit/s), catmull-rom %.2f\n", linear / wire,
              (linear - wire) / n * 8e-3 * keys_per_second, curved / wire);
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
