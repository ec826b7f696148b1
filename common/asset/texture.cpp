// SPDX-License-Identifier: MIT
// wedge tile  low:f32[2] high:f32[2] W:u32; for each row varint its wedges; for each wedge of a row from q on varint
//             its parent, as a number among those of map[row]; for each corner of a vertex of several wedges varint
//             which of them; four planes of a byte for each wedge: the difference of its place to its parent's. The
//             specification is docs/asset-format.md.
#include "common/asset/texture.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <string>

#include "common/asset/asset.h"

namespace eigencast {
namespace {

constexpr float kSteps = 65534;

Error corrupt(std::string what) {
  return fail(ErrorCode::kCorrupt, "texture: " + std::move(what));
}

std::uint16_t folded(std::uint16_t difference) {
  return static_cast<std::uint16_t>((difference << 1) ^ ((difference & 0x8000) != 0 ? 0xffff : 0));
}
std::uint16_t unfolded(std::uint16_t code) {
  return static_cast<std::uint16_t>((code >> 1) ^ ((code & 1) != 0 ? 0xffff : 0));
}

/// The wedge that `wedge` is told from; nothing for the very first.
const std::array<std::uint16_t, 2>* told_from(const AssetTexture& t, std::uint32_t wedge) {
  if (t.parent[wedge] < wedge) return &t.places[t.parent[wedge]];
  return wedge > 0 ? &t.places[wedge - 1] : nullptr;
}

Result<void> check_box(const AssetTexture& t) {
  for (std::size_t d = 0; d < 2; ++d) {
    if (!(std::abs(t.low[d]) <= 1e30F && std::abs(t.high[d]) <= 1e30F && t.low[d] <= t.high[d]))
      return corrupt("the box of its coordinates is not finite or inside out");
  }
  return {};
}

/// What is read of the rows: how many wedges each has, and whose parents they are.
Result<void> read_rows(ByteReader& in, std::uint32_t W, std::uint32_t base_count, std::span<const std::uint32_t> map,
                       AssetTexture& t) {
  t.first_wedge.assign(1, 0);
  t.first_wedge.reserve(map.size() + 1);
  for (std::size_t i = 0; i < map.size(); ++i) {
    const std::uint64_t count = in.varint();
    if (count > W - t.first_wedge.back())
      return corrupt("row " + std::to_string(i) + " has more wedges than there are");
    t.first_wedge.push_back(t.first_wedge.back() + static_cast<std::uint32_t>(count));
  }
  if (t.first_wedge.back() != W) return corrupt("there are wedges of no row");
  t.parent.reserve(W);
  for (std::uint32_t i = 0; i < map.size(); ++i) {
    const std::uint32_t first = t.first_wedge[map[i]], count = t.first_wedge[map[i] + 1] - first;
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w) {
      const std::uint64_t number = i < base_count ? w - first : in.varint();
      if (number >= count) return corrupt("wedge " + std::to_string(w) + " has a parent that is not there");
      t.parent.push_back(first + static_cast<std::uint32_t>(number));
    }
  }
  return {};
}

Result<void> read_corners(ByteReader& in, std::span<const std::array<std::uint32_t, 3>> faces, AssetTexture& t) {
  t.corners.reserve(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    std::array<std::uint32_t, 3> wedges{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t first = t.first_wedge[faces[f][k]], count = t.first_wedge[faces[f][k] + 1] - first;
      const std::uint64_t number = count > 1 ? in.varint() : 0;
      if (number >= count) return corrupt("face " + std::to_string(f) + " has a corner without a wedge");
      wedges[k] = first + static_cast<std::uint32_t>(number);
    }
    t.corners.push_back(wedges);
  }
  return {};
}

}  // namespace

std::array<float, 2> AssetTexture::uv(std::uint32_t wedge) const {
  std::array<float, 2> at{};
  for (std::size_t d = 0; d < 2; ++d)
    at[d] = low[d] + (high[d] - low[d]) * (static_cast<float>(places[wedge][d]) / kSteps);
  return at;
}

std::uint16_t texture_grid(float value, float low, float high) {
  return high > low ? static_cast<std::uint16_t>(std::lround(kSteps * ((value - low) / (high - low)))) : 0;
}

Result<void> validate_texture(const AssetTexture& t, const Asset& asset) {
  const std::size_t n = asset.vertex_count, W = t.places.size();
  if (t.image.size() > AssetTexture::kMaxImageBytes)
    return fail(ErrorCode::kTooLarge,
                "texture: an image of " + std::to_string(t.image.size()) + " bytes; 16 MiB at most");
  if (t.image.empty() || W == 0) return corrupt("there is no image, or nothing that has a place in it");
  if (t.first_wedge.size() != n + 1 || t.first_wedge[0] != 0 || t.first_wedge[n] != W || t.parent.size() != W ||
      t.corners.size() != asset.faces.size() || !std::is_sorted(t.first_wedge.begin(), t.first_wedge.end())) {
    return corrupt("its arrays do not fit the surface");
  }
  if (auto box = check_box(t); !box) return box;
  const auto belongs = [&](std::uint32_t wedge, std::uint32_t row) {
    return wedge >= t.first_wedge[row] && wedge < t.first_wedge[row + 1];
  };
  for (std::uint32_t i = 0; i < n; ++i) {
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w) {
      if (i < asset.base_count ? t.parent[w] != w : !belongs(t.parent[w], asset.map[i]))
        return corrupt("wedge " + std::to_string(w) + " has a parent that is none");
    }
  }
  for (std::size_t f = 0; f < t.corners.size(); ++f) {
    for (std::size_t k = 0; k < 3; ++k) {
      if (!belongs(t.corners[f][k], asset.faces[f][k]))
        return corrupt("face " + std::to_string(f) + " has a wedge of another vertex");
    }
  }
  return {};
}

Bytes encode_wedges(const AssetTexture& t, const Asset& asset) {
  Bytes raw;
  ByteWriter out(raw);
  for (const float value : {t.low[0], t.low[1], t.high[0], t.high[1]}) out.f32(value);
  const auto W = static_cast<std::uint32_t>(t.places.size());
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
    const auto* known = told_from(t, w);
    for (std::size_t d = 0; d < 2; ++d) {
      const std::uint16_t code =
          folded(static_cast<std::uint16_t>(t.places[w][d] - (known != nullptr ? (*known)[d] : 0)));
      raw[planes + (2 * d) * W + w] = static_cast<std::uint8_t>(code);
      raw[planes + (2 * d + 1) * W + w] = static_cast<std::uint8_t>(code >> 8);
    }
  }
  return raw;
}

Result<AssetTexture> decode_wedges(ByteView raw, std::uint32_t base_count, const std::vector<std::uint32_t>& map,
                                   const std::vector<std::array<std::uint32_t, 3>>& faces) {
  AssetTexture t;
  ByteReader in(raw);
  for (float* value : {&t.low[0], &t.low[1], &t.high[0], &t.high[1]}) *value = in.f32();
  const std::uint32_t W = in.u32();
  if (in.failed() || W == 0 || W > raw.size() / 4 || map.size() > raw.size())
    return corrupt("its bytes do not fit its counts");
  if (auto box = check_box(t); !box) return box.error();
  if (auto rows = read_rows(in, W, base_count, map, t); !rows) return rows.error();
  if (auto corners = read_corners(in, faces, t); !corners) return corners.error();
  if (in.failed() || in.remaining() != 4 * std::size_t{W}) return corrupt("its bytes do not fit its counts");
  const ByteView planes = in.bytes(in.remaining());
  t.places.resize(W);
  for (std::uint32_t w = 0; w < W; ++w) {
    const auto* known = told_from(t, w);
    for (std::size_t d = 0; d < 2; ++d) {
      const auto code = static_cast<std::uint16_t>(planes[(2 * d) * W + w] | (planes[(2 * d + 1) * W + w] << 8));
      t.places[w][d] = static_cast<std::uint16_t>(unfolded(code) + (known != nullptr ? (*known)[d] : 0));
    }
  }
  return t;
}

}  // namespace eigencast
