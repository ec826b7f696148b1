// SPDX-License-Identifier: MIT
#include "common/asset/asset.h"
#include "common/asset/tiles/tiles.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

/// Every third vertex has two wedges.
Asset textured_asset(int subdivisions) {
  Asset asset = sample_asset(subdivisions, 7);
  AssetTexture t;
  t.first_wedge.push_back(0);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i)
    t.first_wedge.push_back(t.first_wedge.back() + (i % 3 == 0 ? 2 : 1));
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    const std::uint32_t first = t.first_wedge[asset.map[i]], there = t.first_wedge[asset.map[i] + 1] - first;
    for (std::uint32_t w = t.first_wedge[i]; w < t.first_wedge[i + 1]; ++w) {
      t.parent.push_back(i < asset.base_count ? w : first + (w + i) % there);
      t.uvs.push_back({static_cast<std::uint16_t>(977 * w), static_cast<std::uint16_t>(65000 - 31 * w)});
    }
  }
  t.uvs[5] = AssetTexture::kNone;
  for (std::size_t f = 0; f < asset.faces.size(); ++f) {
    std::array<std::uint32_t, 3> wedges{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t v = asset.faces[f][k];
      wedges[k] = t.first_wedge[v] + static_cast<std::uint32_t>(f + k) % (t.first_wedge[v + 1] - t.first_wedge[v]);
    }
    t.corners.push_back(wedges);
  }
  t.low = {-0.5F, 0};
  t.high = {2, 1};
  t.image = {0x89, 'P', 'N', 'G', 1, 2, 3};
  asset.texture = std::make_shared<const AssetTexture>(std::move(t));
  return asset;
}

void expect_same_texture(const AssetTexture& a, const AssetTexture& b) {
  using T = AssetTexture;
  expect_same(a, b, &T::first_wedge, &T::uvs, &T::parent, &T::corners, &T::low, &T::high, &T::image);
}

TEST(Texture, RoundTripsWithTheLastChunk) {
  const Asset whole = textured_asset(2);
  const auto encoded = encode_asset(whole, {.first_chunk_rows = 20});
  ASSERT_TRUE(encoded) << encoded.error().message;
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(reader);
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    EXPECT_EQ(reader->asset().texture, nullptr);
    ASSERT_TRUE(reader->add_chunk(c, encoded->chunks[c].bytes));
  }
  ASSERT_NE(reader->asset().texture, nullptr);
  expect_same_texture(*reader->asset().texture, *whole.texture);
  EXPECT_TRUE(validate_asset(reader->asset()));
  const auto plain = encode_asset(sample_asset(2, 7), {.first_chunk_rows = 20});
  EXPECT_EQ(decode_asset(*plain)->texture, nullptr);
}

TEST(Texture, ReceiversOfFewBandsHaveNone) {
  const auto encoded = encode_asset(textured_asset(2), {.first_chunk_rows = 20});
  ASSERT_TRUE(encoded);
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    const ByteView bytes(encoded->chunks[c].bytes);
    ASSERT_TRUE(reader->add_chunk(c, bytes.first(reader->chunks()[c].needed_bytes)));
  }
  EXPECT_EQ(reader->asset().texture, nullptr);
}

TEST(Texture, UvsLieOnAGrid) {
  const Asset asset = textured_asset(1);
  EXPECT_EQ(texture_grid(-0.5F, -0.5F, 2), 0);
  EXPECT_EQ(texture_grid(2, -0.5F, 2), 65534);
  EXPECT_EQ(texture_grid(1, 1, 1), 0);
  AssetTexture t = *asset.texture;
  t.uvs[0] = {65534, 0};
  EXPECT_FLOAT_EQ(t.uv(0)[0], 2);
  EXPECT_FLOAT_EQ(t.uv(0)[1], 0);
}

/// Any bytes are refused in words or a texture that is sound.
TEST(Texture, DamagedBytesAreRefusedOrHarmless) {
  const Asset asset = textured_asset(1);
  const Bytes good = encode_uvs(*asset.texture, asset);
  int refused = 0;
  const auto try_bytes = [&](const Bytes& raw) {
    auto decoded = decode_uvs(raw, asset.base_count, asset.map, asset.faces);
    if (!decoded) {
      EXPECT_FALSE(decoded.error().message.empty());
      ++refused;
      return false;
    }
    decoded->image = {1};
    const auto valid = validate_texture(*decoded, asset);
    EXPECT_TRUE(valid) << valid.error().message;
    return true;
  };
  EXPECT_TRUE(try_bytes(good));
  for (std::size_t i = 0; i < good.size(); ++i) {
    for (const int value : {0x00, 0x01, 0x7f, 0x80, 0xff}) {
      Bytes bad = good;
      bad[i] = static_cast<std::uint8_t>(value);
      try_bytes(bad);
    }
    try_bytes(Bytes(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(i)));
  }
  Bytes longer = good;
  longer.push_back(0);
  EXPECT_FALSE(try_bytes(longer));
  Bytes many = good;
  for (std::size_t i = 16; i < 20; ++i) many[i] = 0xff;
  EXPECT_FALSE(try_bytes(many)) << "four thousand million wedges";
  EXPECT_GT(refused, 300);
}

TEST(Texture, TexturesOfOtherSurfacesAreNotEncoded) {
  const auto code_after = [](auto change) {
    Asset asset = textured_asset(1);
    AssetTexture t = *asset.texture;
    change(t);
    asset.texture = std::make_shared<const AssetTexture>(std::move(t));
    const auto result = encode_asset(asset);
    EXPECT_FALSE(result);
    return result ? ErrorCode::kInternal : result.error().code;
  };
  constexpr ErrorCode kInvalid = ErrorCode::kInvalidArgument;
  EXPECT_EQ(code_after([](AssetTexture& t) { t.image.clear(); }), kInvalid);
  EXPECT_EQ(code_after([](AssetTexture& t) { t.image.resize(AssetTexture::kMaxImageBytes + 1); }),
            ErrorCode::kTooLarge);
  EXPECT_EQ(code_after([](AssetTexture& t) { t.corners[3][1] = 0; }), kInvalid);
  EXPECT_EQ(code_after([](AssetTexture& t) { t.parent.back() = t.parent.size() - 1; }), kInvalid);
  EXPECT_EQ(code_after([](AssetTexture& t) { t.corners.pop_back(); }), kInvalid);
  EXPECT_EQ(code_after([](AssetTexture& t) { t.low[0] = NAN; }), kInvalid);
}

TEST(Texture, LargeImagesAreRefused) {
  const auto encoded = encode_asset(textured_asset(1), {.first_chunk_rows = 16});
  ASSERT_TRUE(encoded);
  auto manifest = read_manifest(encoded->manifest.bytes);
  ASSERT_TRUE(manifest);
  TileEntry& tile = manifest->chunks.back().tiles.back();
  ASSERT_EQ(tile.kind, static_cast<std::uint8_t>(TileKind::kImage));
  tile.bytes = static_cast<std::uint32_t>(AssetTexture::kMaxImageBytes) + 1;
  const auto refused = read_manifest(write_manifest(*manifest));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kTooLarge);
}

TEST(Texture, AnEmptyImageIsNone) {
  auto encoded = encode_asset(textured_asset(1), {.first_chunk_rows = 16});
  ASSERT_TRUE(encoded);
  auto manifest = read_manifest(encoded->manifest.bytes);
  ASSERT_TRUE(manifest);
  ChunkEntry& chunk = manifest->chunks.back();
  Bytes& bytes = encoded->chunks.back().bytes;
  bytes.resize(bytes.size() - chunk.tiles.back().bytes);
  chunk.tiles.back().bytes = 0;
  chunk.tiles.back().hash = sha256(Bytes());
  encoded->chunks.back().id = chunk.id = sha256(bytes);
  encoded->manifest.bytes = write_manifest(*manifest);
  encoded->manifest.id = sha256(encoded->manifest.bytes);
  const auto decoded = decode_asset(*encoded);
  ASSERT_TRUE(decoded) << decoded.error().message;
  EXPECT_EQ(decoded->texture, nullptr);
}

}  // namespace
}  // namespace eigencast
