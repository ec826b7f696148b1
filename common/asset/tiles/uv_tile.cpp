// SPDX-License-Identifier: MIT
#include <string>

#include "common/asset/tiles/number_coder.h"
#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

enum : std::size_t { kWedgeCount, kWedgeParent, kWedgeCorner, kWedgeU, kWedgeV, kWedgeKinds };

Error corrupt_uvs(std::string what) {
  return fail(ErrorCode::kCorrupt, "texture: " + std::move(what));
}

/// The wedge that `wedge` is predicted from; null for the very first.
const std::array<std::uint16_t, 2>* predicting_uv(const AssetTexture& t, std::uint32_t wedge) {
  if (t.parent[wedge] < wedge) return &t.uvs[t.parent[wedge]];
  return wedge > 0 ? &t.uvs[wedge - 1] : nullptr;
}

Result<void> read_rows(NumberReader& in, std::uint32_t W, std::uint32_t base_count, std::span<const std::uint32_t> map,
                       AssetTexture& t) {
  t.first_wedge.assign(1, 0);
  t.first_wedge.reserve(map.size() + 1);
  for (std::size_t i = 0; i < map.size(); ++i) {
    const std::uint32_t count = in.pass(kWedgeCount);
    if (count > W - t.first_wedge.back())
      return corrupt_uvs("row " + std::to_string(i) + " has more wedges than there are");
    t.first_wedge.push_back(t.first_wedge.back() + count);
  }
  if (t.first_wedge.back() != W) return corrupt_uvs("there are wedges of no row");
  t.parent.reserve(W);
  for (std::uint32_t i = 0; i < map.size(); ++i) {
    const std::uint32_t first = t.first_wedge[map[i]], count = t.first_wedge[map[i] + 1] - first;
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w) {
      const std::uint32_t number = i < base_count ? w - first : in.pass(kWedgeParent);
      if (number >= count) return corrupt_uvs("wedge " + std::to_string(w) + " has a parent that is not there");
      t.parent.push_back(first + number);
    }
  }
  return {};
}

Result<void> read_corners(NumberReader& in, std::span<const Corners> faces, AssetTexture& t) {
  t.corners.reserve(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    Corners wedges{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t first = t.first_wedge[faces[f][k]], count = t.first_wedge[faces[f][k] + 1] - first;
      const std::uint32_t number = count > 1 ? in.pass(kWedgeCorner) : 0;
      if (number >= count) return corrupt_uvs("face " + std::to_string(f) + " has a corner without a wedge");
      wedges[k] = first + number;
    }
    t.corners.push_back(wedges);
  }
  return {};
}

}  // namespace

Bytes encode_uvs(const AssetTexture& t, const Asset& asset) {
  Bytes coded;
  ByteWriter head(coded);
  for (const float value : {t.low[0], t.low[1], t.high[0], t.high[1]}) head.f32(value);
  head.u32(static_cast<std::uint32_t>(t.uvs.size()));
  NumberWriter out(coded, kWedgeKinds);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) out.pass(kWedgeCount, t.first_wedge[i + 1] - t.first_wedge[i]);
  for (std::uint32_t i = asset.base_count; i < asset.vertex_count; ++i) {
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w)
      out.pass(kWedgeParent, t.parent[w] - t.first_wedge[asset.map[i]]);
  }
  for (std::size_t f = 0; f < t.corners.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t v = asset.faces[f][k];
      if (t.first_wedge[v + 1] - t.first_wedge[v] > 1) out.pass(kWedgeCorner, t.corners[f][k] - t.first_wedge[v]);
    }
  }
  for (std::uint32_t w = 0; w < t.uvs.size(); ++w) {
    const auto* known = predicting_uv(t, w);
    for (std::size_t d = 0; d < 2; ++d)
      out.pass_signed(kWedgeU + d, t.uvs[w][d] - (known != nullptr ? (*known)[d] : 0));
  }
  out.coder().finish();
  return coded;
}

Result<AssetTexture> decode_uvs(ByteView coded, std::uint32_t base_count, const std::vector<std::uint32_t>& map,
                                const std::vector<Corners>& faces) {
  AssetTexture t;
  ByteReader head(coded);
  for (float* value : {&t.low[0], &t.low[1], &t.high[0], &t.high[1]}) *value = head.f32();
  const std::uint32_t W = head.u32();
  if (head.failed() || W == 0 || W > max_wedges(map.size(), faces.size()))
    return corrupt_uvs("its bytes do not fit its counts");
  if (!t.has_finite_box()) return corrupt_uvs("the box of its coordinates is not finite or inside out");
  NumberReader in(coded.subspan(head.position()), kWedgeKinds);
  if (auto rows = read_rows(in, W, base_count, map, t); !rows) return rows.error();
  if (auto corners = read_corners(in, faces, t); !corners) return corners.error();
  t.uvs.resize(W);
  for (std::uint32_t w = 0; w < W; ++w) {
    const auto* known = predicting_uv(t, w);
    for (std::size_t d = 0; d < 2; ++d) {
      const std::int64_t value = std::int64_t{known != nullptr ? (*known)[d] : 0} + in.pass_signed(kWedgeU + d);
      if (value < 0 || value > 65535) return corrupt_uvs("wedge " + std::to_string(w) + " is out of range");
      t.uvs[w][d] = static_cast<std::uint16_t>(value);
    }
  }
  if (!in.coder().finished()) return corrupt_uvs("its bytes do not fit its counts");
  return t;
}

}  // namespace eigencast
