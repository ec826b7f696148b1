// SPDX-License-Identifier: MIT
#include <string>

#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

Error corrupt_uvs(std::string what) {
  return fail(ErrorCode::kCorrupt, "texture: " + std::move(what));
}

/// The wedge that `wedge` is predicted from; null for the very first.
const std::array<std::uint16_t, 2>* predicting_uv(const AssetTexture& t, std::uint32_t wedge) {
  if (t.parent[wedge] < wedge) return &t.uvs[t.parent[wedge]];
  return wedge > 0 ? &t.uvs[wedge - 1] : nullptr;
}

Result<void> read_rows(ByteReader& in, std::uint32_t W, std::uint32_t base_count, std::span<const std::uint32_t> map,
                       AssetTexture& t) {
  t.first_wedge.assign(1, 0);
  t.first_wedge.reserve(map.size() + 1);
  for (std::size_t i = 0; i < map.size(); ++i) {
    const std::uint64_t count = in.varint();
    if (count > W - t.first_wedge.back())
      return corrupt_uvs("row " + std::to_string(i) + " has more wedges than there are");
    t.first_wedge.push_back(t.first_wedge.back() + static_cast<std::uint32_t>(count));
  }
  if (t.first_wedge.back() != W) return corrupt_uvs("there are wedges of no row");
  t.parent.reserve(W);
  for (std::uint32_t i = 0; i < map.size(); ++i) {
    const std::uint32_t first = t.first_wedge[map[i]], count = t.first_wedge[map[i] + 1] - first;
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w) {
      const std::uint64_t number = i < base_count ? w - first : in.varint();
      if (number >= count) return corrupt_uvs("wedge " + std::to_string(w) + " has a parent that is not there");
      t.parent.push_back(first + static_cast<std::uint32_t>(number));
    }
  }
  return {};
}

Result<void> read_corners(ByteReader& in, std::span<const Corners> faces, AssetTexture& t) {
  t.corners.reserve(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    Corners wedges{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t first = t.first_wedge[faces[f][k]], count = t.first_wedge[faces[f][k] + 1] - first;
      const std::uint64_t number = count > 1 ? in.varint() : 0;
      if (number >= count) return corrupt_uvs("face " + std::to_string(f) + " has a corner without a wedge");
      wedges[k] = first + static_cast<std::uint32_t>(number);
    }
    t.corners.push_back(wedges);
  }
  return {};
}

}  // namespace

Bytes encode_uvs(const AssetTexture& t, const Asset& asset) {
  Bytes raw;
  ByteWriter out(raw);
  for (const float value : {t.low[0], t.low[1], t.high[0], t.high[1]}) out.f32(value);
  const auto W = static_cast<std::uint32_t>(t.uvs.size());
  out.u32(W);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) out.varint(t.first_wedge[i + 1] - t.first_wedge[i]);
  for (std::uint32_t i = asset.base_count; i < asset.vertex_count; ++i) {
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w)
      out.varint(t.parent[w] - t.first_wedge[asset.map[i]]);
  }
  for (std::size_t f = 0; f < t.corners.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t v = asset.faces[f][k];
      if (t.first_wedge[v + 1] - t.first_wedge[v] > 1) out.varint(t.corners[f][k] - t.first_wedge[v]);
    }
  }
  const std::size_t planes = raw.size();
  raw.resize(planes + 4 * std::size_t{W});
  for (std::uint32_t w = 0; w < W; ++w) {
    const auto* known = predicting_uv(t, w);
    for (std::size_t d = 0; d < 2; ++d) {
      const std::uint16_t code =
          zigzag16(static_cast<std::uint16_t>(t.uvs[w][d] - (known != nullptr ? (*known)[d] : 0)));
      raw[planes + (2 * d) * W + w] = static_cast<std::uint8_t>(code);
      raw[planes + (2 * d + 1) * W + w] = static_cast<std::uint8_t>(code >> 8);
    }
  }
  return raw;
}

Result<AssetTexture> decode_uvs(ByteView raw, std::uint32_t base_count, const std::vector<std::uint32_t>& map,
                                const std::vector<Corners>& faces) {
  AssetTexture t;
  ByteReader in(raw);
  for (float* value : {&t.low[0], &t.low[1], &t.high[0], &t.high[1]}) *value = in.f32();
  const std::uint32_t W = in.u32();
  if (in.failed() || W == 0 || W > raw.size() / 4 || map.size() > raw.size())
    return corrupt_uvs("its bytes do not fit its counts");
  if (!t.has_finite_box()) return corrupt_uvs("the box of its coordinates is not finite or inside out");
  if (auto rows = read_rows(in, W, base_count, map, t); !rows) return rows.error();
  if (auto corners = read_corners(in, faces, t); !corners) return corners.error();
  if (in.failed() || in.remaining() != 4 * std::size_t{W}) return corrupt_uvs("its bytes do not fit its counts");
  const ByteView planes = in.bytes(in.remaining());
  t.uvs.resize(W);
  for (std::uint32_t w = 0; w < W; ++w) {
    const auto* known = predicting_uv(t, w);
    for (std::size_t d = 0; d < 2; ++d) {
      const auto code = static_cast<std::uint16_t>(planes[(2 * d) * W + w] | (planes[(2 * d + 1) * W + w] << 8));
      t.uvs[w][d] = static_cast<std::uint16_t>(unzigzag16(code) + (known != nullptr ? (*known)[d] : 0));
    }
  }
  return t;
}

}  // namespace eigencast
