// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/asset/detail.h"
#include "common/asset/format/encode.h"
#include "common/asset/format/reader.h"
#include "sample_asset.h"

namespace eigencast {
namespace {

Asset round_trip(const Asset& asset, const AssetEncoding& encoding) {
  const auto encoded = encode_asset(asset, encoding);
  if (!encoded) {
    ADD_FAILURE() << encoded.error().message;
    return {};
  }
  auto decoded = decode_asset(*encoded);
  if (!decoded) {
    ADD_FAILURE() << decoded.error().message;
    return {};
  }
  return std::move(*decoded);
}

void expect_same_structure(const Asset& a, const Asset& b) {
  using A = Asset;
  expect_same(a, b, &A::map, &A::source_vertex, &A::mass, &A::faces, &A::death, &A::rest, &A::band_ends);
}

TEST(AssetRoundTrip, KeepsEveryArrayAndFact) {
  Asset asset = sample_asset(3, 21);
  asset.up_axis = Asset::UpAxis::kZ;
  asset.handedness = Asset::Handedness::kLeft;
  asset.basis_kind = "harmonic";
  asset.operator_kind = "tufted";
  asset.level_errors = {{12, 0.5F, 1.0F}, {641, 0.0F, 0.0F}};
  const Asset decoded = round_trip(asset, {.exact_columns = 4, .first_chunk_rows = 50});
  expect_same_structure(asset, decoded);
  EXPECT_EQ(decoded.vertex_count, 642u);
  EXPECT_EQ(decoded.base_count, asset.base_count);
  EXPECT_EQ(decoded.area, asset.area);
  EXPECT_EQ(decoded.name, asset.name);
  EXPECT_EQ(decoded.basis_kind, "harmonic");
  EXPECT_EQ(decoded.operator_kind, "tufted");
  EXPECT_EQ(decoded.level_errors, asset.level_errors);
  EXPECT_EQ(decoded.up_axis, Asset::UpAxis::kZ);
  EXPECT_EQ(decoded.handedness, Asset::Handedness::kLeft);
  EXPECT_EQ(decoded.metres_per_unit, 0.01);
  EXPECT_EQ(decoded.box_low, asset.box_low);
  EXPECT_EQ(decoded.box_high, asset.box_high);
  EXPECT_EQ(decoded.origin, asset.origin);
  EXPECT_TRUE(decoded.complete());
  EXPECT_EQ(decoded.faces_ready, asset.face_total);
  EXPECT_TRUE(validate_asset(decoded));
}

TEST(AssetRoundTrip, QuantisesWithinHalfAStepOfEachColumn) {
  const Asset asset = sample_asset(3, 40);
  const Asset decoded = round_trip(asset, {.exact_columns = 4, .first_chunk_rows = 100});
  for (std::uint32_t k = 0; k < asset.rank; ++k) {
    double largest = 0, worst = 0;
    for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
      const std::size_t at = std::size_t{i} * asset.rank + k;
      largest = std::max(largest, std::abs(double{asset.floats[at]}));
      worst = std::max(worst, std::abs(double{asset.floats[at]} - double{decoded.entry(i, k)}));
    }
    EXPECT_LE(worst, k < 4 ? 0 : 0.501 * largest / 32767) << "column " << k;
  }
}

// The rest coefficients vanish beyond column 4, so steps must not come from them, and the rest pose must survive
// (docs/asset-format.md, "Basis tile of band b").
TEST(AssetRoundTrip, RestPoseStaysExactAfterQuantisation) {
  const Asset asset = sample_asset(4, 30);
  const Asset decoded = round_trip(asset, {});
  double worst = 0;
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      double rebuilt = 0;
      for (std::uint32_t k = 0; k < asset.rank; ++k) {
        rebuilt += double{decoded.entry(i, k)} * decoded.rest[k * 3 + axis];
      }
      worst = std::max(worst, std::abs(rebuilt - double{asset.entry(i, 1 + axis)}));
    }
  }
  EXPECT_LE(worst, 1e-6 * asset.diagonal());
}

TEST(AssetRoundTrip, SecondTripChangesAtMostOneUlp) {
  const Asset once = round_trip(sample_asset(2, 12), {});
  const Asset twice = round_trip(once, {});
  for (std::uint32_t i = 0; i < once.vertex_count; ++i) {
    for (std::uint32_t k = 0; k < once.rank; ++k) EXPECT_FLOAT_EQ(once.entry(i, k), twice.entry(i, k));
  }
}

TEST(AssetRoundTrip, ColumnsOfZerosAndTinyRanksWork) {
  Asset asset = sample_asset(2, 9);
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) asset.floats[std::size_t{i} * 9 + 6] = 0;
  const Asset decoded = round_trip(asset, {});
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) EXPECT_EQ(decoded.entry(i, 6), 0.0F);
  for (const std::uint32_t rank : {1u, 2u, 4u})
    expect_same_structure(sample_asset(1, rank), round_trip(sample_asset(1, rank), {}));
}

TEST(AssetRoundTrip, PointCloud) {
  const Asset cloud = sample_asset(3, 8, true);
  const Asset decoded = round_trip(cloud, {.first_chunk_rows = 64});
  EXPECT_TRUE(decoded.is_point_cloud());
  expect_same_structure(cloud, decoded);
  EXPECT_EQ(decoded.splats.frame, cloud.splats.frame);
  for (std::uint32_t i = 0; i < cloud.vertex_count; ++i) {
    const auto& n = cloud.splats.normal[i];
    const auto& m = decoded.splats.normal[i];
    EXPECT_GT(n[0] * m[0] + n[1] * m[1] + n[2] * m[2], 0.9998F);  // 1.1 degrees
    EXPECT_GE(decoded.splats.radius[i], cloud.splats.radius[i]);
    EXPECT_LE(decoded.splats.radius[i], 1.045F * cloud.splats.radius[i]);
    EXPECT_GE(decoded.splats.parent_radius[i], i < cloud.base_count ? 0 : cloud.splats.parent_radius[i]);
  }
}

/// Where detail puts the vertices of the rest pose.
std::vector<std::array<double, 3>> detailed_rest(const Asset& asset) {
  std::vector<std::array<double, 3>> positions;
  for (std::size_t i = 0; i < asset.rows_ready; ++i) {
    std::array<double, 3> at{}, x{}, y{}, offset{};
    for (std::size_t k = 0; k < asset.rank; ++k) {
      for (std::size_t d = 0; d < 3; ++d) {
        const double c = asset.rest[3 * k + d], step = double{asset.detail.steps[k]};
        at[d] += c * double{asset.entry(i, k)};
        x[d] += c * step * static_cast<double>(asset.detail.along_x[i * asset.rank + k]);
        y[d] += c * step * static_cast<double>(asset.detail.along_y[i * asset.rank + k]);
      }
    }
    for (std::size_t d = 0; d < 3; ++d) offset[d] = double{asset.detail.offset[i][d]};
    offset = frame_from_derivatives(x, y).from_frame(offset);
    for (std::size_t d = 0; d < 3; ++d) at[d] += offset[d];
    positions.push_back(at);
  }
  return positions;
}

TEST(AssetRoundTrip, DetailKeepsItsDerivativesAndTheRestPose) {
  for (const std::uint32_t axes : {1U, 3U}) {
    Asset asset = sample_asset(2, 8);
    asset.detail = sample_detail(asset, axes);
    // Steps so coarse that the basis moves vertices by more than a percent of the sphere's radius.
    AssetEncoding coarse{.exact_columns = 0, .first_chunk_rows = 20};
    coarse.amplitudes.assign(8, 1);
    coarse.error = 0.05;
    const Asset decoded = round_trip(asset, coarse);
    EXPECT_EQ(decoded.detail.axes, axes);
    EXPECT_EQ(decoded.detail.steps, asset.detail.steps);
    EXPECT_EQ(decoded.detail.along_x, asset.detail.along_x);
    EXPECT_EQ(decoded.detail.along_y, asset.detail.along_y);
    ASSERT_EQ(decoded.detail.size(), asset.vertex_count);
    const auto before = detailed_rest(asset), after = detailed_rest(decoded);
    double moved = 0;
    for (std::size_t i = 0; i < asset.vertex_count; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        moved = std::max(moved, std::abs(after[i][d] - before[i][d]));
        EXPECT_NEAR(decoded.detail.normal[i][d], asset.detail.normal[i][d], 1e-4F);
      }
    }
    EXPECT_EQ(moved < 1e-5, axes == 3) << moved << ": along normals alone it cannot be kept";
  }
}

TEST(AssetReader, DetailArrivesWithItsRowsOrNotAtAll) {
  Asset asset = sample_asset(2, 8);
  asset.band_ends = {3, 8};
  asset.detail = sample_detail(asset, 3);
  const auto encoded = encode_asset(asset, {.first_chunk_rows = 20});
  ASSERT_TRUE(encoded);
  EXPECT_GT(encoded->detail_bytes(), 1000u);
  EXPECT_LT(encoded->detail_bytes(), encoded->total_bytes());
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(reader);
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    ASSERT_TRUE(reader->add_chunk(c, encoded->chunks[c].bytes));
    EXPECT_EQ(reader->asset().detail.size(), reader->asset().rows_ready);
  }
  // With fewer bands there is none, and without the detail of one chunk none of any.
  auto one_band = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes, 1);
  ASSERT_TRUE(one_band && one_band->add_chunk(0, encoded->chunks[0].bytes));
  EXPECT_EQ(one_band->asset().detail.size(), 0u);
  auto thrifty = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(thrifty && thrifty->add_chunk(0, encoded->chunks[0].bytes));
  EXPECT_EQ(thrifty->asset().detail.size(), 20u);
  ASSERT_TRUE(thrifty->add_chunk(1, ByteView(encoded->chunks[1].bytes).first(thrifty->chunks()[1].needed_bytes)));
  ASSERT_TRUE(thrifty->add_chunk(2, encoded->chunks[2].bytes));
  EXPECT_EQ(thrifty->asset().detail.size(), 0u);
}

TEST(AssetReader, SplatsArriveWithTheirRowsOrNotAtAll) {
  const Asset cloud = sample_asset(2, 8, true);
  const auto encoded = encode_asset(cloud, {.first_chunk_rows = 20});
  ASSERT_TRUE(encoded);
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(reader);
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    ASSERT_TRUE(reader->add_chunk(c, encoded->chunks[c].bytes));
    EXPECT_EQ(reader->asset().splats.size(), reader->asset().rows_ready);
  }
  // Only what the bands need of the second chunk: the first's splats go, too.
  auto thrifty = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(thrifty && thrifty->add_chunk(0, encoded->chunks[0].bytes));
  const Bytes& second = encoded->chunks[1].bytes;
  ASSERT_LT(thrifty->chunks()[1].needed_bytes, second.size());
  ASSERT_TRUE(thrifty->add_chunk(1, ByteView(second).first(thrifty->chunks()[1].needed_bytes)));
  EXPECT_EQ(thrifty->asset().splats.size(), 0u);
  ASSERT_TRUE(thrifty->add_chunk(2, encoded->chunks[2].bytes));
  EXPECT_EQ(thrifty->asset().splats.size(), 0u);
}

TEST(AssetReader, ColoursArriveWithTheirRowsOrNotAtAll) {
  for (const bool cloud : {false, true}) {
    Asset whole = sample_asset(2, 8, cloud);
    for (std::uint32_t i = 0; i < whole.vertex_count; ++i) {
      const auto byte = [&](std::uint32_t k) { return static_cast<std::uint8_t>(k * i + 250); };
      whole.colours.push_back({byte(1), byte(77), byte(201)});
    }
    const auto encoded = encode_asset(whole, {.first_chunk_rows = 20});
    ASSERT_TRUE(encoded);
    auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
    ASSERT_TRUE(reader);
    for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
      ASSERT_TRUE(reader->add_chunk(c, encoded->chunks[c].bytes));
      const Asset& part = reader->asset();
      ASSERT_EQ(part.colours.size(), part.rows_ready);
      EXPECT_TRUE(std::equal(part.colours.begin(), part.colours.end(), whole.colours.begin()));
    }
    EXPECT_EQ(reader->asset().splats.size(), cloud ? whole.vertex_count : 0);
    auto thrifty = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
    ASSERT_TRUE(thrifty && thrifty->add_chunk(0, encoded->chunks[0].bytes));
    ASSERT_TRUE(thrifty->add_chunk(1, ByteView(encoded->chunks[1].bytes).first(thrifty->chunks()[1].needed_bytes)));
    ASSERT_TRUE(thrifty->add_chunk(2, encoded->chunks[2].bytes));
    EXPECT_TRUE(thrifty->asset().colours.empty());
  }
}

TEST(AssetReader, NormalsArriveWithTheirRowsOrNotAtAll) {
  Asset whole = sample_asset(2, 8);
  for (std::uint32_t i = 0; i < whole.vertex_count; ++i)
    whole.normals.push_back(static_cast<std::uint8_t>(i * i % 7 % Asset::kNormalsValues));
  const auto encoded = encode_asset(whole, {.first_chunk_rows = 20});
  ASSERT_TRUE(encoded);
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(reader);
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    ASSERT_TRUE(reader->add_chunk(c, encoded->chunks[c].bytes));
    const Asset& part = reader->asset();
    ASSERT_EQ(part.normals.size(), part.rows_ready);
    EXPECT_TRUE(std::equal(part.normals.begin(), part.normals.end(), whole.normals.begin()));
  }
  auto thrifty = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(thrifty && thrifty->add_chunk(0, encoded->chunks[0].bytes));
  ASSERT_TRUE(thrifty->add_chunk(1, ByteView(encoded->chunks[1].bytes).first(thrifty->chunks()[1].needed_bytes)));
  ASSERT_TRUE(thrifty->add_chunk(2, encoded->chunks[2].bytes));
  EXPECT_TRUE(thrifty->asset().normals.empty());
}

TEST(AssetEncode, NormalsAreOneOfThreeValuesForEachRow) {
  Asset asset = sample_asset(1, 6);
  asset.normals.resize(asset.vertex_count - 1);
  EXPECT_EQ(encode_asset(asset).error().code, ErrorCode::kInvalidArgument);
  asset.normals.resize(asset.vertex_count, Asset::kNormalsValues);
  EXPECT_EQ(encode_asset(asset).error().code, ErrorCode::kInvalidArgument);
}

TEST(AssetEncode, ColoursNeedOneForEachRow) {
  Asset asset = sample_asset(1, 6);
  asset.colours.resize(asset.vertex_count - 1);
  const auto result = encode_asset(asset);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
}

TEST(AssetReader, EachArrivedPrefixIsTheSurfaceAtThatLevel) {
  const Asset whole = sample_asset(3, 10);
  const auto encoded = encode_asset(whole, {.first_chunk_rows = 40});
  ASSERT_TRUE(encoded);
  ASSERT_EQ(encoded->chunks.size(), 6u);  // 40, 80, 160, 320, 640, 642
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes);
  ASSERT_TRUE(reader) << reader.error().message;
  EXPECT_EQ(reader->asset().rows_ready, 0u);
  EXPECT_EQ(reader->asset().vertex_count, whole.vertex_count);
  EXPECT_EQ(reader->asset().rest, whole.rest);
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    const auto added = reader->add_chunk(c, encoded->chunks[c].bytes);
    ASSERT_TRUE(added) << added.error().message;
    const Asset& part = reader->asset();
    const std::uint32_t N = part.rows_ready;
    EXPECT_EQ(N, reader->chunks()[c].end_row);
    EXPECT_EQ(part.floats.size() + part.integers.size(), std::size_t{N} * whole.rank);
    EXPECT_TRUE(std::equal(part.map.begin(), part.map.end(), whole.map.begin()));
    EXPECT_TRUE(std::equal(part.death.begin(), part.death.end(), whole.death.begin()));
    ASSERT_EQ(part.faces.size(), part.faces_ready);
    EXPECT_TRUE(part.faces_ready == whole.face_total || whole.death[part.faces_ready] >= N);
    for (std::size_t f = 0; f < part.faces.size(); ++f) {
      EXPECT_LT(part.death[f], N);
      for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(part.faces[f][k], corner_at_level(whole, whole.faces[f][k], N));
    }
  }
  EXPECT_TRUE(reader->asset().complete());
  EXPECT_EQ(reader->asset().faces, whole.faces);
}

TEST(AssetReader, FewBandsNeedOnlyAPrefixOfEachChunk) {
  const Asset whole = sample_asset(3, 30);
  const auto encoded = encode_asset(whole, {.first_chunk_rows = 100});
  ASSERT_TRUE(encoded);
  auto reader = AssetReader::from_manifest(encoded->manifest.id, encoded->manifest.bytes, 1);
  ASSERT_TRUE(reader);
  const Asset all = round_trip(whole, {.first_chunk_rows = 100});
  for (std::size_t c = 0; c < encoded->chunks.size(); ++c) {
    const auto& ref = reader->chunks()[c];
    ASSERT_LT(ref.needed_bytes, ref.bytes);
    const auto added = reader->add_chunk(c, ByteView(encoded->chunks[c].bytes).first(ref.needed_bytes));
    ASSERT_TRUE(added) << added.error().message;
  }
  const Asset& few = reader->asset();
  EXPECT_EQ(few.faces, whole.faces);
  for (std::uint32_t i = 0; i < few.vertex_count; ++i) {
    for (std::uint32_t k = 0; k < few.rank; ++k) {
      ASSERT_EQ(few.entry(i, k), k < 4 ? all.entry(i, k) : 0.0F);
    }
  }
}

TEST(AssetEncode, RefusesWhatIsNotAnAsset) {
  const auto expect_refused = [](auto change, std::string_view offender, ErrorCode code = ErrorCode::kInvalidArgument) {
    Asset asset = sample_asset(1, 6);
    change(asset);
    const auto result = encode_asset(asset);
    ASSERT_FALSE(result) << offender;
    EXPECT_EQ(result.error().code, code) << result.error().message;
    EXPECT_NE(result.error().message.find(offender), std::string::npos) << result.error().message;
  };
  expect_refused([](Asset& a) { a.map[20] = 20; }, "row 20");
  expect_refused([](Asset& a) { a.map[2] = 1; }, "row 2");
  expect_refused([](Asset& a) { a.source_vertex[5] = a.source_vertex[4]; }, "row 5");
  expect_refused([](Asset& a) { a.mass[7] = 0; }, "row 7");
  expect_refused([](Asset& a) { a.floats[6 * 9 + 2] = NAN; }, "row 9: basis column 2");
  expect_refused([](Asset& a) { a.rest[4] = INFINITY; }, "rest coefficient 1");
  expect_refused([](Asset& a) { std::swap(a.death.front(), a.death.back()); }, "face ");
  expect_refused([](Asset& a) { a.faces[3][1] = 42; }, "face 3");
  expect_refused([](Asset& a) { a.band_ends = {4, 4, 6}; }, "band 1");
  expect_refused([](Asset& a) { a.rows_ready = 12; }, "");
  expect_refused([](Asset& a) { a.name.assign(2000, 'x'); }, "", ErrorCode::kTooLarge);
  expect_refused([](Asset& a) { a = Asset(); }, "");
}

}  // namespace
}  // namespace eigencast
