// SPDX-License-Identifier: MIT
// Every byte of an asset may come from an enemy who also computes the hashes, so most cases here rehash what they
// damage.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <string>
#include <tuple>
#include <utility>

#include "common/asset/asset_limits.h"
#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "common/asset/tiles/tiles.h"
#include "heap.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

EncodedAsset sample(bool cloud = false, bool detail = false) {
  Asset asset = sample_asset(1, 7, cloud);
  if (detail) asset.detail = sample_detail(asset, 3);
  for (std::uint8_t i = 0; cloud && i < asset.vertex_count; ++i)
    asset.colours.push_back({i, static_cast<std::uint8_t>(40 * i), 9});
  for (std::uint8_t i = 0; !cloud && i < asset.vertex_count; ++i) asset.normals.push_back(i % Asset::kNormalsValues);
  auto encoded = encode_asset(asset, {.exact_columns = 4, .first_chunk_rows = 16});
  EXPECT_TRUE(encoded);
  return std::move(*encoded);
}

/// Reads a manifest whose hash is right whatever it holds.
Result<AssetReader> reader_of(const Bytes& manifest) {
  return AssetReader::from_manifest(sha256(manifest), manifest);
}

/// The asset with its manifest changed and, for the id, hashed again.
EncodedAsset with_manifest(EncodedAsset encoded, const std::function<void(Manifest&)>& change) {
  auto manifest = read_manifest(encoded.manifest.bytes);
  EXPECT_TRUE(manifest);
  change(*manifest);
  encoded.manifest.bytes = write_manifest(*manifest);
  encoded.manifest.id = sha256(encoded.manifest.bytes);
  return encoded;
}

/// Damages the stored bytes of one tile and makes every hash fit again.
EncodedAsset with_tile(const EncodedAsset& encoded, std::size_t chunk, std::size_t tile,
                       const std::function<void(Bytes&)>& change) {
  auto manifest = read_manifest(encoded.manifest.bytes);
  EXPECT_TRUE(manifest);
  EncodedAsset damaged = encoded;
  Bytes& bytes = damaged.chunks[chunk].bytes;
  std::ptrdiff_t begin = 0;
  for (std::size_t t = 0; t < tile; ++t) begin += manifest->chunks[chunk].tiles[t].bytes;
  TileEntry& entry = manifest->chunks[chunk].tiles[tile];
  Bytes part(bytes.begin() + begin, bytes.begin() + begin + entry.bytes);
  bytes.erase(bytes.begin() + begin, bytes.begin() + begin + entry.bytes);
  change(part);
  bytes.insert(bytes.begin() + begin, part.begin(), part.end());
  entry.bytes = static_cast<std::uint32_t>(part.size());
  entry.hash = sha256(part);
  damaged.chunks[chunk].id = manifest->chunks[chunk].id = sha256(bytes);
  damaged.manifest.bytes = write_manifest(*manifest);
  damaged.manifest.id = sha256(damaged.manifest.bytes);
  return damaged;
}

/// Either an error with words, or an asset that is sound: nothing between.
void expect_error_or_sound(const EncodedAsset& encoded, int& errors) {
  const auto decoded = decode_asset(encoded);
  if (decoded) {
    const auto valid = validate_asset(*decoded);
    EXPECT_TRUE(valid) << valid.error().message;
  } else {
    EXPECT_FALSE(decoded.error().message.empty());
    ++errors;
  }
}

TEST(AssetHostile, ObjectsOfAManifestAreItsChunksAndSections) {
  for (const bool cloud : {false, true}) {
    const EncodedAsset encoded = with_manifest(sample(cloud), [](Manifest& m) {
      m.sections.push_back({99, true, 1000, sha256(Bytes{1})});  // Of a later build.
      m.chunks[0].tiles.back().kind = 200;
    });
    ASSERT_FALSE(read_manifest(encoded.manifest.bytes)) << "this build cannot show it";
    std::vector<Sha256> expected;
    for (const auto& chunk : encoded.chunks) expected.push_back(chunk.id);
    expected.push_back(sha256(Bytes{1}));
    EXPECT_EQ(objects_of_manifest(encoded.manifest.bytes), expected);
  }
}

TEST(AssetHostile, EveryTruncationOfTheManifestIsAnError) {
  const Bytes whole = sample().manifest.bytes;
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const Bytes part(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    const auto reader = reader_of(part);
    ASSERT_FALSE(reader) << size;
    EXPECT_EQ(reader.error().code, ErrorCode::kCorrupt) << size << ": " << reader.error().message;
    EXPECT_TRUE(objects_of_manifest(part).empty()) << size;
  }
  Bytes longer = whole;
  longer.push_back(0);
  EXPECT_FALSE(reader_of(longer));
  EXPECT_TRUE(objects_of_manifest(longer).empty());
}

TEST(AssetHostile, EveryFlippedBitIsCaughtByTheHashes) {
  const EncodedAsset good = sample();
  for (std::size_t i = 0; i < good.manifest.bytes.size(); ++i) {
    Bytes bad = good.manifest.bytes;
    bad[i] ^= static_cast<std::uint8_t>(1U << (i % 8));
    EXPECT_FALSE(AssetReader::from_manifest(good.manifest.id, bad)) << i;
  }
  for (std::size_t i = 0; i < good.chunks[0].bytes.size(); ++i) {
    EncodedAsset bad = good;
    bad.chunks[0].bytes[i] ^= static_cast<std::uint8_t>(1U << (i % 8));
    EXPECT_FALSE(decode_asset(bad)) << i;
  }
}

TEST(AssetHostile, RehashedManifestDamageIsRefusedOrHarmless) {
  const EncodedAsset good = sample();
  int errors = 0;
  for (std::size_t i = 0; i < good.manifest.bytes.size(); ++i) {
    for (const int value : {0x00, 0x01, 0x7f, 0x80, 0xff}) {
      EncodedAsset bad = good;
      bad.manifest.bytes[i] = static_cast<std::uint8_t>(value);
      bad.manifest.id = sha256(bad.manifest.bytes);
      expect_error_or_sound(bad, errors);
    }
  }
  EXPECT_GT(errors, 1000);
}

TEST(AssetHostile, RehashedTileDamageIsRefusedOrHarmless) {
  for (const bool more : {false, true}) {
    const EncodedAsset good = sample(more, more);
    const auto manifest = read_manifest(good.manifest.bytes);
    int errors = 0;
    for (std::size_t c = 0; c < good.chunks.size(); ++c) {
      for (std::size_t t = 0; t < manifest->chunks[c].tiles.size(); ++t) {
        for (std::size_t i = 0; i < manifest->chunks[c].tiles[t].bytes; ++i) {
          for (const int value : {0x00, 0x01, 0x7f, 0x80, 0xff}) {
            expect_error_or_sound(with_tile(good, c, t, [&](Bytes& b) { b[i] = static_cast<std::uint8_t>(value); }),
                                  errors);
          }
          // Numbers beyond the end of a run are decoded from zeros.
          expect_error_or_sound(with_tile(good, c, t, [&](Bytes& b) { b.resize(i); }), errors);
        }
        const EncodedAsset longer = with_tile(good, c, t, [](Bytes& b) { b.push_back(0); });
        EXPECT_FALSE(decode_asset(longer)) << "chunk " << c << " tile " << t;
      }
    }
    EXPECT_GT(errors, 500);
  }
}

TEST(AssetHostile, WrongChunksAreErrorsThatChangeNothing) {
  const EncodedAsset good = sample();
  auto reader = reader_of(good.manifest.bytes);
  ASSERT_TRUE(reader);
  const auto code_of = [](const Result<void>& result) { return result ? ErrorCode::kInternal : result.error().code; };
  EXPECT_EQ(code_of(reader->add_chunk(1, good.chunks[1].bytes)), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of(reader->add_chunk(0, good.chunks[1].bytes)), ErrorCode::kCorrupt);
  EXPECT_EQ(code_of(reader->add_chunk(0, {})), ErrorCode::kCorrupt);
  EXPECT_EQ(reader->asset().rows_ready, 0u);
  EXPECT_TRUE(reader->add_chunk(0, good.chunks[0].bytes));
  EXPECT_EQ(code_of(reader->add_chunk(0, good.chunks[0].bytes)), ErrorCode::kInvalidArgument);
  EXPECT_EQ(code_of(reader->add_chunk(1, good.chunks[0].bytes)), ErrorCode::kCorrupt);
  EXPECT_EQ(reader->asset().rows_ready, 16u);
  for (std::size_t c = 1; c < good.chunks.size(); ++c) EXPECT_TRUE(reader->add_chunk(c, good.chunks[c].bytes));
  EXPECT_TRUE(reader->asset().complete());
  EXPECT_EQ(code_of(reader->add_chunk(good.chunks.size(), {})), ErrorCode::kInvalidArgument);
}

/// The tile of a kind in a chunk.
std::size_t tile_of(const EncodedAsset& encoded, std::size_t chunk, TileKind kind) {
  const auto manifest = read_manifest(encoded.manifest.bytes);
  std::size_t tile = 0;
  while (!manifest->chunks[chunk].tiles[tile].is(kind)) ++tile;
  return tile;
}

TEST(AssetHostile, BadTilesLeaveTheReaderUnchanged) {
  const EncodedAsset good = sample(true, true);
  for (const TileKind kind : {TileKind::kStructure, TileKind::kBasis, TileKind::kDetail, TileKind::kSplats}) {
    SCOPED_TRACE(static_cast<int>(kind));
    auto reader = reader_of(good.manifest.bytes);
    ASSERT_TRUE(reader && reader->add_chunk(0, good.chunks[0].bytes));
    const Asset before = reader->asset();
    int refused = 0;
    for (int value = 0; value < 256; ++value) {
      const EncodedAsset changed = with_tile(good, 1, tile_of(good, 1, kind),
                                             [&](Bytes& b) { b[b.size() / 4] = static_cast<std::uint8_t>(value); });
      auto other = reader_of(changed.manifest.bytes);
      ASSERT_TRUE(other && other->add_chunk(0, changed.chunks[0].bytes));
      if (other->add_chunk(1, changed.chunks[1].bytes)) continue;
      ++refused;
      using A = Asset;
      expect_same(other->asset(), before, &A::rows_ready, &A::map, &A::floats, &A::integers, &A::faces, &A::mass);
      EXPECT_EQ(other->asset().detail.along_x, before.detail.along_x);
      EXPECT_EQ(other->asset().detail.along_y, before.detail.along_y);
      EXPECT_EQ(other->asset().detail.size(), before.detail.size());
      EXPECT_EQ(other->asset().splats.size(), before.splats.size());
    }
    EXPECT_GT(refused, 100);
  }
}

TEST(AssetHostile, OtherVersionsAreRefused) {
  Bytes manifest = sample().manifest.bytes;
  manifest[8] = 2;
  const auto reader = reader_of(manifest);
  ASSERT_FALSE(reader);
  EXPECT_EQ(reader.error().code, ErrorCode::kIncompatibleVersion);
}

TEST(AssetHostile, AbsurdClaimsAreRefusedBeforeAllocation) {
  const auto code_after = [](const std::function<void(Manifest&)>& change) {
    const auto reader = reader_of(with_manifest(sample(), change).manifest.bytes);
    return reader ? ErrorCode::kInternal : reader.error().code;
  };
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.vertex_count = 16'000'001; }), ErrorCode::kTooLarge);
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.face_total = 4'000'000'000U; }), ErrorCode::kTooLarge);
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.rank = 5000; }), ErrorCode::kTooLarge);
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.vertex_count = 15'000'000, m.facts.rank = 4000; }),
            ErrorCode::kTooLarge);
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.vertex_count = 1'000'000; }), ErrorCode::kCorrupt);
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.vertex_count = m.chunks.back().end_row = 1'000'000; }),
            ErrorCode::kTooLarge);  // No coder comes to so little.
  EXPECT_EQ(code_after([](Manifest& m) { m.facts.level_errors.assign(33, {}); }), ErrorCode::kCorrupt);
  const GeometricError wrong_errors[] = {{0, 0, 0},  {42, 0, 0},   {20, -1, 0},
                                         {20, 2, 1}, {20, NAN, 1}, {20, 0, INFINITY}};
  for (const GeometricError& wrong : wrong_errors)
    EXPECT_EQ(code_after([&](Manifest& m) { m.facts.level_errors = {wrong}; }), ErrorCode::kCorrupt);
}

/// What one reader has taken at most.
struct Taken {
  std::uint64_t bytes = 0, stated = 0;
  std::optional<ErrorCode> refused;
};
Taken take_whole(const EncodedAsset& encoded) {
  watch_heap();
  const std::size_t before = heap_use().now;
  Taken taken;
  const auto read = [&]() -> Result<void> {
    auto reader = reader_of(encoded.manifest.bytes);
    if (!reader) return reader.error();
    taken.stated = reader->memory_bytes();
    for (std::size_t i = 0; i < encoded.chunks.size(); ++i) {
      if (auto added = reader->add_chunk(i, encoded.chunks[i].bytes); !added) return added;
    }
    return {};
  };
  if (const auto whole = read(); !whole) taken.refused = whole.error().code;
  taken.bytes = heap_use().peak - before;
  return taken;
}

TEST(AssetHostile, LyingSizesOfTilesTakeNoMemory) {
  for (const bool cloud : {false, true}) {
    const EncodedAsset good = sample(cloud, true);
    const std::uint64_t honest = take_whole(good).bytes;
    const auto manifest = read_manifest(good.manifest.bytes);
    for (std::size_t c = 0; c < manifest->chunks.size(); ++c) {
      for (std::size_t t = 0; t < manifest->chunks[c].tiles.size(); ++t) {
        for (const std::uint32_t bytes : {0u, 1u, 100'000u, 1u << 20, 200u << 20, ~0u}) {
          const Taken taken = take_whole(with_manifest(good, [&](Manifest& m) { m.chunks[c].tiles[t].bytes = bytes; }));
          EXPECT_TRUE(taken.refused) << "chunk " << c << " tile " << t << " of " << bytes << " bytes";
          EXPECT_LE(taken.bytes, 2 * honest + 100'000) << "chunk " << c << " tile " << t << " of " << bytes << " bytes";
        }
      }
    }
  }
}

TEST(AssetHostile, MemoryIsStatedBeforeItIsTaken) {
  Asset flat = sample_asset(5, 64);
  std::fill(flat.floats.begin(), flat.floats.end(), 0.0F);  // packs a thousandfold
  const auto bomb = encode_asset(flat, {.exact_columns = 0, .first_chunk_rows = 64});
  ASSERT_TRUE(bomb) << bomb.error().message;
  for (const EncodedAsset& encoded : {*bomb, sample(false, true), sample(true, true)}) {
    const Taken taken = take_whole(encoded);
    EXPECT_FALSE(taken.refused);
    EXPECT_GT(taken.bytes, 0u);
    EXPECT_LE(taken.bytes, taken.stated);
  }
  // Beyond what a reader takes: what rebuilds and draws it.
  EXPECT_GE(take_whole(*bomb).stated, 3 * flat.floats.size() * sizeof(std::int16_t));
  EXPECT_LE(take_whole(*bomb).stated, 10 * flat.floats.size() * sizeof(std::int16_t));
}

TEST(AssetHostile, RepeatedSourceVertexIsRefused) {
  const EncodedAsset good = sample();
  auto reader = reader_of(good.manifest.bytes);
  ASSERT_TRUE(reader && reader->add_chunk(0, good.chunks[0].bytes));
  const Asset& asset = reader->asset();
  const EncodedAsset bad = with_tile(good, 1, 0, [&](Bytes& b) {
    const EarlierStructure earlier{asset.source_vertex, asset.mass, asset.faces};
    const ChunkRange range{16, 32, asset.base_count, asset.vertex_count};
    auto tile =
        decode_structure(b, range, read_manifest(good.manifest.bytes)->chunks[1].end_face - asset.faces_ready, earlier);
    ASSERT_TRUE(tile);
    tile->source_vertex.back() = asset.source_vertex.front();
    b = encode_structure(range, *tile, earlier);
  });
  const auto decoded = decode_asset(bad);
  ASSERT_FALSE(decoded);
  EXPECT_EQ(decoded.error().code, ErrorCode::kCorrupt) << decoded.error().message;
}

TEST(AssetExtensions, UnknownTilesAreSkippedUnlessRequired) {
  const auto extended = [](bool required, std::uint8_t kind) {
    EncodedAsset encoded = sample();
    const Bytes extra = {1, 2, 3};
    Bytes& chunk = encoded.chunks[1].bytes;
    chunk.insert(chunk.end(), extra.begin(), extra.end());
    return with_manifest(std::move(encoded), [&](Manifest& m) {
      const TileEntry tile{kind, 0, required, 3, sha256(extra)};
      m.chunks[1].tiles.push_back(tile);
      m.chunks[1].id = sha256(chunk);
    });
  };
  const auto skipped = decode_asset(extended(false, 130));
  ASSERT_TRUE(skipped) << skipped.error().message;
  EXPECT_EQ(skipped->faces, sample_asset(1, 7).faces);
  EXPECT_EQ(decode_asset(extended(true, 130)).error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(decode_asset(extended(false, 2)).error().code, ErrorCode::kCorrupt);

  const auto with_section = [](bool required) {
    return with_manifest(sample(), [&](Manifest& m) { m.sections.push_back({32, required, 1000, Sha256{}}); });
  };
  EXPECT_TRUE(decode_asset(with_section(false)));
  EXPECT_EQ(decode_asset(with_section(true)).error().code, ErrorCode::kUnsupported);
}

TEST(AssetHostile, BadDetailTileKeepsEarlierSplats) {
  const EncodedAsset no_splats = with_manifest(sample(true, true), [&](Manifest& m) {
    for (TileEntry& tile : m.chunks[1].tiles) {
      if (tile.is(TileKind::kSplats)) tile.kind = 200;  // private: skipped
    }
  });
  const EncodedAsset bad = with_tile(no_splats, 1, tile_of(no_splats, 1, TileKind::kDetail),
                                     [](Bytes& b) { std::fill(b.begin(), b.end(), std::uint8_t{0x5a}); });
  auto reader = reader_of(bad.manifest.bytes);
  ASSERT_TRUE(reader && reader->add_chunk(0, bad.chunks[0].bytes));
  const std::size_t before = reader->asset().splats.size();
  ASSERT_GT(before, 0u);
  ASSERT_FALSE(reader->add_chunk(1, bad.chunks[1].bytes));
  EXPECT_EQ(reader->asset().splats.size(), before);
}

TEST(AssetExtensions, ReadersWithoutDetailReadTheRest) {
  const EncodedAsset detailed = sample(false, true);
  // What is private means to this reader what detail means to one that was built before it.
  const auto without = decode_asset(with_manifest(detailed, [](Manifest& m) {
    for (ChunkEntry& chunk : m.chunks) {
      for (TileEntry& tile : chunk.tiles) tile.kind = tile.kind == 22 ? 200 : tile.kind;
    }
  }));
  ASSERT_TRUE(without) << without.error().message;
  const auto plain = decode_asset(sample());
  ASSERT_TRUE(plain);
  EXPECT_EQ(without->detail.size(), 0u);
  EXPECT_EQ(without->integers, plain->integers);
  EXPECT_EQ(without->faces, plain->faces);
}

}  // namespace
}  // namespace eigencast
