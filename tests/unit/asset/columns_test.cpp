// SPDX-License-Identifier: MIT
#include "common/asset/format/columns.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "heap.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

constexpr std::uint32_t kRank = 7, kColumns = 3;

struct Sample {
  EncodedAsset encoded;
  Asset asset;  ///< As readers have it.
  ColumnValues columns;
  EncodedColumns more;
};

ColumnValues sample_columns(std::uint32_t rows) {
  ColumnValues columns;
  for (std::uint32_t k = 0; k < kColumns; ++k) columns.scales.push_back(0.01F * static_cast<float>(k + 1));
  for (std::uint32_t i = 0; i < rows * kColumns; ++i) columns.values.push_back(std::sin(0.7F * static_cast<float>(i)));
  return columns;
}

Sample with_some(bool cloud = false) {
  Sample made;
  made.encoded = std::move(*encode_asset(sample_asset(2, kRank, cloud), {.exact_columns = 4, .first_chunk_rows = 16}));
  made.asset = std::move(*decode_asset(made.encoded));
  made.columns = sample_columns(made.asset.vertex_count);
  auto more = encode_columns(made.asset, made.encoded, made.columns);
  EXPECT_TRUE(more) << more.error().message;
  made.more = std::move(*more);
  return made;
}

AssetReader reader_with(const Sample& made, std::size_t bands = AssetReader::kAllBands) {
  auto reader = AssetReader::from_manifest(made.more.manifest.id, made.more.manifest.bytes, bands);
  EXPECT_TRUE(reader) << reader.error().message;
  return std::move(*reader);
}

std::vector<std::uint32_t> chunk_ends_of(const Sample& made) {
  return reader_with(made).chunk_ends();
}

TEST(Columns, ComeBehindTheBasisOnTheirGrid) {
  for (const bool cloud : {false, true}) {
    const Sample made = with_some(cloud);
    const auto wider = with_columns(made.asset, made.more.section.bytes, chunk_ends_of(made));
    ASSERT_TRUE(wider) << wider.error().message;
    EXPECT_TRUE(validate_asset(*wider));
    EXPECT_EQ(wider->rank, kRank + kColumns);
    EXPECT_EQ(wider->band_ends.size(), made.asset.band_ends.size() + 1);
    for (std::uint32_t row = 0; row < wider->vertex_count; ++row) {
      for (std::uint32_t k = 0; k < kRank; ++k) ASSERT_EQ(wider->entry(row, k), made.asset.entry(row, k));
      for (std::uint32_t k = 0; k < kColumns; ++k) {
        ASSERT_NEAR(wider->entry(row, kRank + k), made.columns.values[row * kColumns + k],
                    0.5001F * made.columns.scales[k]);
      }
    }
  }
}

TEST(Columns, ReadWithTheChunksAreAsThoseAddedLater) {
  const Sample made = with_some();
  const auto whole = with_columns(made.asset, made.more.section.bytes, chunk_ends_of(made));
  AssetReader reader = reader_with(made);
  ASSERT_TRUE(reader.columns());
  EXPECT_EQ(reader.columns()->id, made.more.section.id);
  ASSERT_GT(reader.chunks().size(), 2u);
  ASSERT_TRUE(reader.add_columns(made.more.section.bytes));
  for (std::size_t i = 0; i < made.encoded.chunks.size(); ++i) {
    EXPECT_EQ(reader.chunks()[i].id, made.encoded.chunks[i].id) << "the same chunks";
    ASSERT_TRUE(reader.add_chunk(i, made.encoded.chunks[i].bytes));
    const Asset& part = reader.asset();
    ASSERT_EQ(part.integers.size(), part.rows_ready * part.column_scales.size());
    EXPECT_TRUE(std::equal(part.integers.begin(), part.integers.end(), whole->integers.begin()));
  }
  EXPECT_EQ(reader.asset().integers, whole->integers);
  EXPECT_EQ(reader.asset().band_ends, whole->band_ends);
}

TEST(Columns, ReadersWithoutThemHaveTheAsset) {
  const Sample made = with_some();
  AssetReader without = reader_with(made), fewer_bands = reader_with(made, 1);
  EXPECT_FALSE(fewer_bands.columns());
  for (std::size_t i = 0; i < made.encoded.chunks.size(); ++i)
    ASSERT_TRUE(without.add_chunk(i, made.encoded.chunks[i].bytes));
  EXPECT_EQ(without.asset().integers, made.asset.integers);
  EXPECT_EQ(without.asset().rank, kRank);
  EXPECT_EQ(without.add_columns(made.more.section.bytes).error().code, ErrorCode::kInvalidArgument) << "too late";
  auto plain = AssetReader::from_manifest(made.encoded.manifest.id, made.encoded.manifest.bytes);
  ASSERT_TRUE(plain);
  EXPECT_FALSE(plain->columns());
  EXPECT_EQ(plain->add_columns(made.more.section.bytes).error().code, ErrorCode::kInvalidArgument);
}

TEST(Columns, OnlyTheBytesOfTheManifestAreTaken) {
  const Sample made = with_some();
  AssetReader reader = reader_with(made);
  Bytes other = made.more.section.bytes;
  other.back() ^= 1;
  EXPECT_EQ(reader.add_columns(other).error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(reader.asset().rank, kRank) << "nothing has changed";
  EXPECT_TRUE(reader.add_columns(made.more.section.bytes));
  EXPECT_EQ(reader.add_columns(made.more.section.bytes).error().code, ErrorCode::kInvalidArgument) << "once";
}

TEST(Columns, EveryTruncationIsRefused) {
  const Sample made = with_some();
  const std::vector<std::uint32_t> ends = chunk_ends_of(made);
  const Bytes& whole = made.more.section.bytes;
  for (std::size_t bytes = 0; bytes < whole.size(); ++bytes) {
    const auto read = with_columns(made.asset, ByteView(whole).first(bytes), ends);
    ASSERT_FALSE(read) << bytes;
    EXPECT_EQ(read.error().code, ErrorCode::kCorrupt) << bytes;
  }
  Bytes longer = whole;
  longer.push_back(0);
  EXPECT_EQ(with_columns(made.asset, longer, ends).error().code, ErrorCode::kCorrupt);
}

TEST(Columns, DamageIsAnErrorOrSound) {
  const Sample made = with_some();
  const std::vector<std::uint32_t> ends = chunk_ends_of(made);
  int errors = 0;
  for (std::size_t at = 0; at < made.more.section.bytes.size(); ++at) {
    for (const int change : {1, 0x80, 0xff}) {
      Bytes bytes = made.more.section.bytes;
      bytes[at] = static_cast<std::uint8_t>(bytes[at] ^ change);
      const auto read = with_columns(made.asset, bytes, ends);
      if (read)
        EXPECT_TRUE(validate_asset(*read));
      else
        ++errors;
    }
  }
  EXPECT_GT(errors, 50);
}

TEST(Columns, ClaimsAreCheckedBeforeMemoryIsTaken) {
  constexpr std::uint32_t kRows = 16'000'000;
  Bytes bytes{64};
  ByteWriter out(bytes);
  for (int k = 0; k < 64; ++k) out.f32(1);
  out.u32(1);
  out.u8(0);
  const std::vector<std::uint32_t> many_rows{kRows}, ends{100};
  watch_heap();
  const std::size_t before = heap_use().now;
  const auto parsed = ColumnsSection::parse(bytes, many_rows);
  EXPECT_LT(heap_use().peak - before, 100'000u);
  ASSERT_FALSE(parsed);
  EXPECT_EQ(parsed.error().code, ErrorCode::kTooLarge);
  for (const float scale : {0.0F, -1.0F, 1e-38F, std::numeric_limits<float>::quiet_NaN()}) {
    Bytes one{1};
    ByteWriter(one).f32(scale);
    ByteWriter(one).u32(0);
    EXPECT_EQ(ColumnsSection::parse(one, ends).error().code, ErrorCode::kCorrupt);
  }
  for (const std::uint8_t count : {0, 65, 255}) {
    Bytes many(1000, 0x3f);
    many[0] = count;
    EXPECT_EQ(ColumnsSection::parse(many, ends).error().code, ErrorCode::kCorrupt);
  }
}

TEST(Columns, AssetsThatTakeNoneSayWhy) {
  const Sample made = with_some();
  Asset eight = made.asset;
  eight.band_ends = {0, 1, 2, 3, 4, 5, 6, 7};
  EXPECT_EQ(check_columns(eight, 1).error().code, ErrorCode::kUnsupported);
  Asset detailed = made.asset;
  detailed.detail = sample_detail(made.asset, 3);
  EXPECT_EQ(check_columns(detailed, 1).error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(check_columns(made.asset, 4096).error().code, ErrorCode::kTooLarge);
  EncodedAsset again = made.encoded;
  again.manifest = made.more.manifest;
  EXPECT_EQ(encode_columns(made.asset, again, made.columns).error().code, ErrorCode::kInvalidArgument);
  ColumnValues short_of = made.columns;
  short_of.values.pop_back();
  EXPECT_EQ(encode_columns(made.asset, made.encoded, short_of).error().code, ErrorCode::kInvalidArgument);
  ColumnValues zero = made.columns;
  zero.scales[1] = 0;
  EXPECT_EQ(encode_columns(made.asset, made.encoded, zero).error().code, ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace eigencast
