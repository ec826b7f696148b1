// SPDX-License-Identifier: MIT
//
// codec_rate CLIP [RANK [KEYS_PER_SECOND]]: bakes the augmented basis of a clip's first frame, codes the clip as a
// chain of keys at eps = 1/4 of the truncation error, and reports rates, Karni-Gotsman errors, and the time that each
// kind of frame takes.
#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "common/codec/chain.h"
#include "common/spectral/basis.h"
#include "common/surface/read.h"

namespace {

using namespace eigencast;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

template <typename T>
T value_or_exit(Result<T> result) {
  if (result) return *std::move(result);
  std::fprintf(stderr, "codec_rate: %s\n", result.error().message.c_str());
  std::exit(1);
}

/// Bytes and microseconds of all frames of one kind; every encoded payload is decoded and compared.
struct Tally {
  std::size_t frames = 0;
  std::size_t payload_bytes = 0;
  double encode_us = 0;
  double decode_us = 0;

  template <typename Encode, typename Decode, typename Value>
  void add(Encode&& encode, Decode&& decode, const Value& expected) {
    using Clock = std::chrono::steady_clock;
    const auto begin = Clock::now();
    const Bytes payload = value_or_exit(encode());
    const auto middle = Clock::now();
    const auto decoded = value_or_exit(decode(ByteView(payload)));
    const auto end = Clock::now();
    if (!(decoded == expected)) {
      std::fprintf(stderr, "codec_rate: a frame decodes to something else\n");
      std::exit(1);
    }
    ++frames;
    payload_bytes += payload.size();
    encode_us += std::chrono::duration<double, std::micro>(middle - begin).count();
    decode_us += std::chrono::duration<double, std::micro>(end - middle).count();
  }

  void print(const char* name, double frames_per_second) const {
    const auto n = static_cast<double>(std::max<std::size_t>(frames, 1));
    const double bytes = static_cast<double>(payload_bytes) / n;
    std::printf(
        "%-10s %8.1f bytes/frame  %7.1f kbit/s payload  %7.1f with envelopes  encode %6.1f us  decode %6.1f us\n", name,
        bytes, bytes * 8e-3 * frames_per_second, (bytes + 28) * 8e-3 * frames_per_second, encode_us / n, decode_us / n);
  }
};

RowMajor matrix_from(const std::vector<double>& C) {
  return Eigen::Map<const RowMajor>(C.data(), static_cast<Eigen::Index>(C.size() / 3), 3);
}

struct Clip {
  Surface rest;
  std::vector<std::vector<Vec3>> poses;
};

Clip read_clip(const std::filesystem::path& path) {
  const bool arrays = std::filesystem::exists(path / "vertices.npy");
  const auto source = value_or_exit(open_clip(arrays ? (path / "vertices.npy").string() : path.string()));
  Clip clip{source->rest(), {}};
  for (std::size_t i = 0; i < source->frame_count(); ++i) clip.poses.push_back(value_or_exit(source->pose(i)));
  return clip;
}

void run(const Clip& clip, int rank, double keys_per_second) {
  const Basis basis =
      value_or_exit(build_basis(clip.rest, value_or_exit(build_laplacian(clip.rest)), {BasisKind::kAugmented, rank}));
  const auto r = static_cast<std::uint32_t>(basis.Psi.cols());
  const CoefficientLayout layout{CodecKind::kQuantised, r, 3, default_band_ends(r)};

  KgError truncation;
  double error = 0;
  std::vector<std::vector<double>> coefficients;
  for (const auto& pose : clip.poses) {
    const RowMajor C = coefficients_from_positions(basis, pose);
    coefficients.emplace_back(C.data(), C.data() + C.size());
    const auto rebuilt = positions_from_coefficients(basis, C);
    truncation.add_frame(pose, rebuilt);
    for (std::size_t i = 0; i < pose.size(); ++i) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double e = pose[i][axis] - rebuilt[i][axis];
        error += basis.mass[static_cast<Eigen::Index>(i)] * e * e;
      }
    }
  }
  const double rms = std::sqrt(error / (basis.area * static_cast<double>(clip.poses.size())));
  const std::uint8_t step = step_index_below(step_for_error(rms / 4, basis.area, r));

  Tally keys, joins, synthetics;
  KgError total;
  std::optional<ChainState> state;
  for (std::size_t i = 0; i < coefficients.size(); ++i) {
    const Key key = value_or_exit(key_from_coefficients(layout, coefficients[i], step));
    total.add_frame(clip.poses[i], positions_from_coefficients(basis, matrix_from(coefficients_from_key(layout, key))));
    if (state) {
      for (std::uint32_t at = 1; at < 3; ++at) {
        const Key pose = value_or_exit(interpolate_keys(layout, state->newer, key, at, 3));
        synthetics.add([&] { return encode_key(layout, *state, pose); },
                       [&](ByteView payload) { return decode_key(layout, pose.bands, *state, payload); }, pose);
      }
      keys.add([&] { return encode_key(layout, *state, key); },
               [&](ByteView payload) { return decode_key(layout, key.bands, *state, payload); }, key);
    }
    state = advanced(state, key, state ? 33'333 : 0);
    joins.add([&] { return encode_join(layout, *state); },
              [&](ByteView payload) { return decode_join(layout, state->newer.bands, payload); }, *state);
  }

  std::printf("r %u, %zu frames, truncation rms %.4g, step %d (%.4g)\n", r, clip.poses.size(), rms, int{step},
              step_size(step));
  std::printf("KG truncation %.3f %%, total %.3f %%\n", truncation.percent(), total.percent());
  keys.print("key", keys_per_second);
  synthetics.print("synthetic", 2 * keys_per_second);
  joins.print("join", 1);
  const double full =
      static_cast<double>(keys.payload_bytes + synthetics.payload_bytes) / static_cast<double>(keys.payload_bytes);
  std::printf("x3 full costs %.2f times the keys alone\n", full);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: codec_rate CLIP [RANK [KEYS_PER_SECOND]]\n");
    return 2;
  }
  run(read_clip(argv[1]), argc > 2 ? std::atoi(argv[2]) : 200, argc > 3 ? std::atof(argv[3]) : 30);
  return 0;
}
