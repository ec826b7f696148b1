// SPDX-License-Identifier: MIT
//
// codec_peers CLIP [RANK [EPS_OVER_DIAGONAL]]: what a clip takes as coefficients and as geometry, frame by frame, as
// CSV. Rows "without ..." are the stream with one mechanism off, at the same quantiser.
//
// The geometry codecs get the coarsest grid whose Karni-Gotsman error is no larger than that of the quantised stream in
// all. Both round positions to a cubic grid over the box of the frame, so that their error is taken from that rounding
// (Draco gives vertices back in another order).
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <string>

#include "common/codec/chain.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/formats/clip.h"
#include "sdk/bake.h"
#include "sdk/publisher.h"
#include "sender/surface_error.h"

#ifdef EIGENCAST_HAS_DRACO
#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#endif
#ifdef EIGENCAST_HAS_MESHOPTIMIZER
#include <meshoptimizer.h>
#endif

namespace {

using namespace eigencast;

constexpr double kRateHz = 30;
constexpr int kMinBits = 4, kMaxBits = 16;

template <typename T>
T value_or_exit(Result<T> result) {
  if (result) return *std::move(result);
  std::fprintf(stderr, "codec_peers: %s\n", result.error().message.c_str());
  std::exit(1);
}

using Poses = std::vector<std::vector<Vec3>>;

struct Grid {
  Vec3 low{};
  double unit = 1;
};

Grid grid_of(const std::vector<Vec3>& pose, int bits) {
  const Box box = bounding_box(pose);
  double side = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) side = std::max(side, box.high[axis] - box.low[axis]);
  return {box.low, side / ((1 << bits) - 1)};
}

double error_on_grid(const Poses& poses, int bits, double diagonal) {
  SurfaceErrorSum sum(diagonal);
  for (const auto& pose : poses) {
    const Grid grid = grid_of(pose, bits);
    std::vector<Vec3> rounded = pose;
    for (Vec3& v : rounded) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        v[axis] = grid.low[axis] + grid.unit * std::round((v[axis] - grid.low[axis]) / grid.unit);
    }
    sum.add(pose, rounded);
  }
  return sum.result().kg_percent;
}

struct Row {
  std::string method;
  double bytes_per_frame = 0, kg_percent = 0, encode_us = 0;
  std::size_t first_bytes = 0;  ///< Before the first pose can be shown.
};

void print(const std::string& clip, std::size_t vertices, const Row& row) {
  std::printf("%s,%zu,%s,%.1f,%.1f,%.4f,%zu,%.1f\n", clip.c_str(), vertices, row.method.c_str(), row.bytes_per_frame,
              row.bytes_per_frame * 8e-3 * kRateHz, row.kg_percent, row.first_bytes, row.encode_us);
}

/// The mean over all poses of the bytes and of the time that `encode` takes.
Row each_pose(const std::string& method, const Poses& poses,
              const std::function<std::size_t(const std::vector<Vec3>&)>& encode) {
  Row row{method};
  const auto begin = std::chrono::steady_clock::now();
  for (const auto& pose : poses) row.bytes_per_frame += static_cast<double>(encode(pose));
  const std::chrono::duration<double, std::micro> took = std::chrono::steady_clock::now() - begin;
  const auto n = static_cast<double>(poses.size());
  row.bytes_per_frame /= n;
  row.encode_us = took.count() / n;
  return row;
}

#ifdef EIGENCAST_HAS_DRACO
/// One frame, with its faces: Draco has no codec of vertices alone that keeps their order.
std::size_t draco_bytes(const Surface& rest, const std::vector<Vec3>& pose, int bits) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(static_cast<int>(rest.faces.size()));
  const int position = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  const auto corner = [&](std::uint32_t v) {
    return std::array<float, 3>{static_cast<float>(pose[v][0]), static_cast<float>(pose[v][1]),
                                static_cast<float>(pose[v][2])};
  };
  for (std::size_t f = 0; f < rest.faces.size(); ++f) {
    const auto a = corner(rest.faces[f][0]), b = corner(rest.faces[f][1]), c = corner(rest.faces[f][2]);
    builder.SetAttributeValuesForFace(position, draco::FaceIndex(static_cast<std::uint32_t>(f)), a.data(), b.data(),
                                      c.data());
  }
  const auto mesh = builder.Finalize();
  draco::Encoder encoder;
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, bits);
  encoder.SetSpeedOptions(3, 3);  // Draco's own default of its tool: compression level 7.
  draco::EncoderBuffer buffer;
  if (!mesh || !encoder.EncodeMeshToBuffer(*mesh, &buffer).ok()) {
    std::fprintf(stderr, "codec_peers: Draco refused a frame\n");
    std::exit(1);
  }
  return buffer.size();
}
#endif

#ifdef EIGENCAST_HAS_MESHOPTIMIZER
std::size_t meshopt_bytes(const std::vector<Vec3>& pose, int bits) {
  const Grid grid = grid_of(pose, bits);
  std::vector<std::array<std::uint16_t, 4>> vertices(pose.size());  // The codec wants multiples of four bytes.
  for (std::size_t i = 0; i < pose.size(); ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis)
      vertices[i][axis] = static_cast<std::uint16_t>(std::lround((pose[i][axis] - grid.low[axis]) / grid.unit));
  }
  std::vector<unsigned char> out(meshopt_encodeVertexBufferBound(vertices.size(), sizeof vertices[0]));
  return meshopt_encodeVertexBuffer(out.data(), out.size(), vertices.data(), vertices.size(), sizeof vertices[0]);
}
#endif

/// What keys are predicted from.
enum class Predicted { kFromTwo, kFromOne, kFromNone };

/// The payload of `key`, which becomes the one that is decoded.
CodedKey encode(const CoefficientLayout& layout, const ChainState& state, const Key& key, const Quantiser& quantiser,
                Predicted predicted) {
  switch (predicted) {
    case Predicted::kFromTwo:
      return value_or_exit(encode_key(layout, state, key, quantiser.half_spacing));
    case Predicted::kFromOne:
      return value_or_exit(encode_key(layout, {state.newer, state.newer}, key, quantiser.half_spacing));
    case Predicted::kFromNone:
      break;
  }
  const std::uint8_t spacing = step_index_below(2.0 * quantiser.half_spacing * step_size(quantiser.step));
  const Key coarse = value_or_exit(key_from_coefficients(layout, coefficients_from_key(layout, key), spacing));
  const Key nothing = empty_key(layout, {}, spacing);
  return value_or_exit(encode_key(layout, {nothing, nothing}, coarse, 0));
}

/// The clip as a stream of coefficients.
Row as_coefficients(const std::string& method, CodecKind codec, const BakeResult& baked, const Poses& poses, double eps,
                    Predicted predicted = Predicted::kFromTwo) {
  const Asset& asset = baked.asset;
  const Projector projector = value_or_exit(Projector::create(asset));
  const CoefficientLayout layout{codec, asset.rank, 3, asset.band_ends};
  Quantiser quantiser = quantiser_for_error(eps * asset.diagonal(), asset.area, asset.rank);
  if (codec != CodecKind::kQuantised) quantiser.half_spacing = 0;
  SurfaceErrorSum sum(asset.diagonal());
  SourceRebuilder rebuilder(asset);
  std::optional<ChainState> state;
  Row row{method};
  row.first_bytes = baked.encoded.total_bytes();
  double encode_us = 0;
  for (const auto& pose : poses) {
    std::vector<double> flat;
    for (const Vec3& vertex : pose) flat.insert(flat.end(), vertex.begin(), vertex.end());
    const auto C = value_or_exit(projector.coefficients_from_positions(std::span<const double>(flat)));
    Key key = value_or_exit(key_from_coefficients(layout, C, quantiser.step));
    if (state) {
      const auto begin = std::chrono::steady_clock::now();
      auto coded = encode(layout, *state, key, quantiser, predicted);
      encode_us += std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count();
      row.bytes_per_frame += static_cast<double>(coded.payload.size());
      key = std::move(coded.key);
    }
    sum.add(pose, rebuilder.rebuild(coefficients_from_key(layout, key), 3));
    state = advanced(std::move(state), std::move(key), state ? 33'333 : 0);
  }
  const auto n = static_cast<double>(poses.size() - 1);
  row.bytes_per_frame /= n;
  row.encode_us = encode_us / n;
  row.kg_percent = sum.result().kg_percent;
  return row;
}

void run(const MotionClip& clip, const std::string& name, int rank, double eps) {
  const KnownMotion motion = motion_of(clip);
  const auto baked_as = [&](BasisKind basis, int columns) {
    BakeOptions options;
    options.basis = basis;
    options.rank = columns;
    if (basis == BasisKind::kPca) options.motion = &motion;
    return value_or_exit(bake(clip.rest(), options, {}));
  };
  const BakeResult baked = baked_as(BasisKind::kAugmented, rank);
  const double diagonal = baked.asset.diagonal();
  Poses poses;
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) poses.push_back(value_or_exit(clip.pose(frame)));
  const std::size_t vertices = clip.rest().vertex_count();
  const std::size_t faces_bytes = clip.rest().faces.size() * 12;

  const Row ours = as_coefficients("eigencast", CodecKind::kQuantised, baked, poses, eps);
  print(name, vertices, ours);
  print(name, vertices, as_coefficients("coefficients float32", CodecKind::kFloat32, baked, poses, eps));
  print(name, vertices, as_coefficients("coefficients float64", CodecKind::kFloat64, baked, poses, eps));
  constexpr int kWholeClipColumns = 50;  // The sender's default of that basis.
  print(name, vertices,
        as_coefficients("whole-clip PCA", CodecKind::kQuantised, baked_as(BasisKind::kPca, kWholeClipColumns), poses,
                        eps));
  print(name, vertices,
        as_coefficients("without the key before the last", CodecKind::kQuantised, baked, poses, eps,
                        Predicted::kFromOne));
  print(name, vertices,
        as_coefficients("without prediction", CodecKind::kQuantised, baked, poses, eps, Predicted::kFromNone));
  print(name, vertices,
        as_coefficients("without products", CodecKind::kQuantised, baked_as(BasisKind::kHarmonic, rank), poses, eps));

  int bits = kMinBits;
  while (bits < kMaxBits && error_on_grid(poses, bits, diagonal) > ours.kg_percent) ++bits;
  [[maybe_unused]] const double kg_percent = error_on_grid(poses, bits, diagonal);
  [[maybe_unused]] const std::string at_bits = " " + std::to_string(bits) + " bit";
#ifdef EIGENCAST_HAS_DRACO
  Row draco = each_pose("Draco a frame" + at_bits, poses,
                        [&](const auto& pose) { return draco_bytes(clip.rest(), pose, bits); });
  draco.kg_percent = kg_percent;
  print(name, vertices, draco);
#endif
#ifdef EIGENCAST_HAS_MESHOPTIMIZER
  Row meshopt =
      each_pose("meshoptimizer a frame" + at_bits, poses, [&](const auto& pose) { return meshopt_bytes(pose, bits); });
  meshopt.kg_percent = kg_percent;
  meshopt.first_bytes = faces_bytes;
  print(name, vertices, meshopt);
#endif
  print(name, vertices, {"vertices float32", static_cast<double>(vertices) * 12, 0, 0, faces_bytes});
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: codec_peers CLIP [RANK [EPS_OVER_DIAGONAL]]\n");
    return 2;
  }
  const std::string path(argv[1]);
  const auto clip = value_or_exit(open_clip(path));
  const std::string folder = path.substr(0, path.find_last_of('/'));
  std::printf("clip,vertices,method,bytes_per_frame,kbit_per_s,kg_percent,first_bytes,encode_us\n");
  run(*clip, folder.substr(folder.find_last_of('/') + 1), argc > 2 ? std::atoi(argv[2]) : 200,
      argc > 3 ? std::atof(argv[3]) : kDefaultErrorOverDiagonal);
  return 0;
}
