// SPDX-License-Identifier: MIT
// Every byte of an asset may come from an enemy who also computes the hashes, so most cases here rehash what they
// damage.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <string>
#include <tuple>
#include <utility>

#include "common/asset/asset_limits.h"
#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "common/asset/tiles/compression.h"
#include "heap.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

EncodedAsset sample(bool compress = false, bool cloud = false, bool detail = false) {
  Asset asset = sample_asset(1, 7, cloud);
  if (detail) asset.detail = sample_detail(asset, 3);
  for (std::uint8_t i = 0; cloud && i < asset.vertex_count; ++i)
    asset.colours.push_back({i, static_cast<std::uint8_t>(40 * i), 9});
  auto encoded =
      encode_asset(asset, {.exact_columns = 4, .first_chunk_rows = 16, .compress = compress, .code = compress});
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
  for (std::size_t t = 0; t < tile; ++t) begin += manifest->chunks[chunk].tiles[t].stored_bytes;
  TileEntry& entry = manifest->chunks[chunk].tiles[tile];
  Bytes part(bytes.begin() + begin, bytes.begin() + begin + entry.stored_bytes);
  bytes.erase(bytes.begin() + begin, bytes.begin() + begin + entry.stored_bytes);
  change(part);
  bytes.insert(bytes.begin() + begin, part.begin(), part.end());
  if (entry.compression == Compression::kStored) entry.raw_bytes = static_cast<std::uint32_t>(part.size());
  entry.stored_bytes = static_cast<std::uint32_t>(part.size());
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
    const EncodedAsset encoded = with_manifest(sample(true, cloud), [](Manifest& m) {
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
  const EncodedAsset good = sample(true);
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
  for (const auto& [compress, cloud, detail] :
       {std::tuple{false, false, false}, {true, false, false}, {false, true, true}}) {
    const EncodedAsset good = sample(compress, cloud, detail);
    const auto manifest = read_manifest(good.manifest.bytes);
    int errors = 0;
    for (std::size_t c = 0; c < good.chunks.size(); ++c) {
      for (std::size_t t = 0; t < manifest->chunks[c].tiles.size(); ++t) {
        for (std::size_t i = 0; i < manifest->chunks[c].tiles[t].stored_bytes; ++i) {
          for (const int value : {0x00, 0x01, 0x7f, 0x80, 0xff}) {
            expect_error_or_sound(with_tile(good, c, t, [&](Bytes& b) { b[i] = static_cast<std::uint8_t>(value); }),
                                  errors);
          }
          const EncodedAsset cut = with_tile(good, c, t, [&](Bytes& b) { b.resize(i); });
          EXPECT_FALSE(decode_asset(cut)) << "chunk " << c << " tile " << t << " cut to " << i << " bytes";
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

TEST(AssetHostile, BadBasisTileLeavesTheReaderUnchanged) {
  const EncodedAsset good = sample();
  const EncodedAsset bad = with_tile(good, 1, 1, [](Bytes& b) {
    const std::size_t floats = b.size() / 4;
    b[3 * floats] = 0x7f;  // the high bytes of the first float: an infinity
    b[2 * floats] = 0x80;
    b[floats] = b[0] = 0;
  });
  auto reader = reader_of(bad.manifest.bytes);
  ASSERT_TRUE(reader);
  ASSERT_TRUE(reader->add_chunk(0, bad.chunks[0].bytes));
  const Asset before = reader->asset();
  const auto added = reader->add_chunk(1, bad.chunks[1].bytes);
  ASSERT_FALSE(added);
  EXPECT_NE(added.error().message.find("row 16 column 0"), std::string::npos) << added.error().message;
  EXPECT_EQ(reader->asset().rows_ready, before.rows_ready);
  EXPECT_EQ(reader->asset().map, before.map);
  EXPECT_EQ(reader->asset().floats, before.floats);
  EXPECT_EQ(reader->asset().integers, before.integers);
  EXPECT_EQ(reader->asset().faces, before.faces);
}

TEST(AssetHostile, BadDetailTileLeavesTheReaderUnchanged) {
  const EncodedAsset good = sample(false, true, true);
  const auto manifest = read_manifest(good.manifest.bytes);
  std::size_t tile = 0;
  while (manifest->chunks[1].tiles[tile].kind != static_cast<std::uint8_t>(TileKind::kDetail)) ++tile;
  auto reader = reader_of(good.manifest.bytes);
  ASSERT_TRUE(reader && reader->add_chunk(0, good.chunks[0].bytes));
  const Asset before = reader->asset();
  int refused = 0;
  for (int value = 0; value < 256; ++value) {
    const EncodedAsset changed = with_tile(good, 1, tile, [&](Bytes& b) {
      const std::size_t rows = manifest->chunks[1].end_row - 16, column = 5;  // of no step
      b[rows * 2 * (2 + 3) + column * rows] = static_cast<std::uint8_t>(value);
    });
    auto other = reader_of(changed.manifest.bytes);
    ASSERT_TRUE(other && other->add_chunk(0, changed.chunks[0].bytes));
    if (other->add_chunk(1, changed.chunks[1].bytes)) continue;
    ++refused;
    EXPECT_EQ(other->asset().rows_ready, before.rows_ready);
    EXPECT_EQ(other->asset().detail.along_x, before.detail.along_x);
    EXPECT_EQ(other->asset().detail.along_y, before.detail.along_y);
    EXPECT_EQ(other->asset().splats.size(), before.splats.size());
    EXPECT_EQ(other->asset().integers, before.integers);
  }
  EXPECT_EQ(refused, 255);  // What a column of no step holds is zero.
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
            ErrorCode::kCorrupt);
  EXPECT_EQ(code_after([](Manifest& m) {  // sizes that fit the rows but that no compressor reaches
              m.facts.vertex_count = m.chunks.back().end_row = 2'000'000;
              const std::uint32_t rows = 2'000'000 - 32;
              TileEntry* tiles = m.chunks.back().tiles.data();
              for (int t = 0; t < 3; ++t) tiles[t].compression = Compression::kZstd, tiles[t].stored_bytes = 100;
              tiles[0].raw_bytes = rows * 7, tiles[1].raw_bytes = rows * 16, tiles[2].raw_bytes = rows * 6;
            }),
            ErrorCode::kTooLarge);
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
  for (const bool compress : {false, true}) {
    for (const bool cloud : {false, true}) {
      const EncodedAsset good = sample(compress, cloud, true);
      const std::uint64_t honest = take_whole(good).bytes;
      const auto manifest = read_manifest(good.manifest.bytes);
      for (std::size_t c = 0; c < manifest->chunks.size(); ++c) {
        for (std::size_t t = 0; t < manifest->chunks[c].tiles.size(); ++t) {
          for (const std::uint64_t raw : {0u, 1u, 100'000u, 1u << 20, 200u << 20, ~0u}) {
            for (const auto compression : {Compression::kStored, Compression::kZstd, Compression::kCoded}) {
              const Taken taken = take_whole(with_manifest(good, [&](Manifest& m) {
                TileEntry& tile = m.chunks[c].tiles[t];
                if (tile.raw_bytes == raw) return;
                tile.raw_bytes = static_cast<std::uint32_t>(raw);
                tile.compression = compression;
              }));
              EXPECT_LE(taken.bytes, 2 * honest + 100'000)
                  << "chunk " << c << " tile " << t << " of " << raw << " bytes";
            }
          }
        }
      }
    }
  }
}

TEST(AssetHostile, LyingZstdFramesTakeNoMemory) {
  const EncodedAsset good = sample(true);
  const auto manifest = read_manifest(good.manifest.bytes);
  ASSERT_EQ(manifest->chunks[0].tiles[0].compression, Compression::kZstd);
  const std::uint64_t honest = take_whole(good).bytes;
  const std::size_t raw = manifest->chunks[0].tiles[0].raw_bytes;
  for (const std::size_t size : {raw - 1, raw + 1, 100 * raw, std::size_t{8} << 20}) {
    // A frame that holds other bytes than its tile says, and that the manifest believes or not.
    const Bytes packed = *zstd_compress(Bytes(size, 0));
    const Taken taken = take_whole(with_tile(good, 0, 0, [&](Bytes& b) { b = packed; }));
    EXPECT_EQ(taken.refused, ErrorCode::kCorrupt) << size;
    EXPECT_LE(taken.bytes, 2 * honest + 100'000) << size;
  }
}

TEST(AssetHostile, MemoryIsStatedBeforeItIsTaken) {
  Asset flat = sample_asset(5, 64);
  std::fill(flat.floats.begin(), flat.floats.end(), 0.0F);  // packs a thousandfold
  const auto bomb = encode_asset(flat, {.exact_columns = 0, .first_chunk_rows = 64, .compress = true, .code = false});
  ASSERT_TRUE(bomb) << bomb.error().message;
  for (const EncodedAsset& encoded : {*bomb, sample(true, false, true), sample(false, true, true)}) {
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
  // The last chunk: ten parents of a byte each, then ten source vertices as differences to the parent's, of a byte
  // each. A difference of 0 in the last row repeats its parent's number, and no other row follows from it.
  const EncodedAsset bad = with_tile(good, 2, 0, [](Bytes& b) { b[19] = 0; });
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
      TileEntry tile{kind, 0, required, Compression::kStored, 3, 3, sha256(extra)};
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
  const auto is_of = [](TileKind kind) {
    return [kind](const TileEntry& tile) { return tile.kind == static_cast<std::uint8_t>(kind); };
  };
  const EncodedAsset no_splats = with_manifest(sample(false, true, true), [&](Manifest& m) {
    auto& tiles = m.chunks[1].tiles;
    std::find_if(tiles.begin(), tiles.end(), is_of(TileKind::kSplats))->kind = 200;  // private: skipped
  });
  const auto tiles = read_manifest(no_splats.manifest.bytes)->chunks[1].tiles;
  const auto detail = std::find_if(tiles.begin(), tiles.end(), is_of(TileKind::kDetail)) - tiles.begin();
  const EncodedAsset bad = with_tile(no_splats, 1, static_cast<std::size_t>(detail),
                                     [](Bytes& b) { std::fill(b.begin(), b.end(), std::uint8_t{0x5a}); });
  auto reader = reader_of(bad.manifest.bytes);
  ASSERT_TRUE(reader && reader->add_chunk(0, bad.chunks[0].bytes));
  const std::size_t before = reader->asset().splats.size();
  ASSERT_GT(before, 0u);
  ASSERT_FALSE(reader->add_chunk(1, bad.chunks[1].bytes));
  EXPECT_EQ(reader->asset().splats.size(), before);
}

TEST(AssetExtensions, ReadersWithoutDetailReadTheRest) {
  const EncodedAsset detailed = sample(false, false, true);
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

TEST(AssetCompression, RefusesAllButOneFrameOfTheStatedSize) {
  const Bytes raw(1000, 7);
  const auto packed = zstd_compress(raw);
  ASSERT_TRUE(packed);
  EXPECT_EQ(*zstd_decompress(*packed, 1000), raw);
  EXPECT_FALSE(zstd_decompress(*packed, 999));
  EXPECT_FALSE(zstd_decompress(*packed, 1001));
  EXPECT_FALSE(zstd_decompress({}, 0));
  Bytes twice = *packed;
  twice.insert(twice.end(), packed->begin(), packed->end());
  EXPECT_FALSE(zstd_decompress(twice, 1000));
  for (std::size_t size = 0; size < packed->size(); ++size)
    EXPECT_FALSE(zstd_decompress(ByteView(*packed).first(size), 1000));
}

}  // namespace
}  // namespace eigencast
