// SPDX-License-Identifier: MIT
// The bytes of two small assets, rough and smooth, and what they mean in an independent text form (golden.json, which
// the Python reader is held against as well). EIGENCAST_WRITE_GOLDEN=1 writes them anew after a deliberate change of
// the format, which then needs a new version.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "common/asset/format/columns.h"
#include "common/asset/format/encode.h"
#include "common/asset/format/manifest.h"
#include "common/asset/format/reader.h"
#include "sample_asset.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

using Json = nlohmann::json;

/// 42 vertices, chunks of 16, 16 and 10 rows, columns 0-3 exact and 4 quantised, in bands 0-3 and 4. Every float is a
/// multiple of a power of two, so that no compiler's or library's rounding can change a byte.
Asset golden_asset() {
  Asset asset = sample_asset(1, 5);
  asset.name = "golden icosphere";
  asset.level_errors = {{12, 0.125F, 0.25F}, {20, 0.0625F, 0.1875F}};
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    asset.mass[i] = 0.25F + 0.0625F * static_cast<float>(i % 5);
    for (std::uint32_t k = 0; k < 5; ++k) {
      const std::uint32_t noise = ((i * 5 + k) * 2654435761U) >> 22;
      asset.floats[i * 5 + k] = k == 0 ? 0.5F : (static_cast<float>(noise) - 512.0F) / 512.0F;
    }
  }
  asset.floats[7 * 5 + 4] = 32767.0F / 16384.0F;  // the largest of its column, so that its scale is 2^-14
  return asset;
}

/// 162 vertices, chunks of 48, 48 and 66 rows, columns 0-3 exact, in one band.
Asset smooth_asset() {
  Asset asset = sample_asset(2, 9);
  asset.band_ends = {9};
  asset.name = "golden icosphere, smooth";
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) asset.mass[i] = 0.25F + 0.0625F * static_cast<float>(i % 5);
  return asset;
}

std::string golden_path(const std::string& name) {
  return golden_dir() + "/" + name;
}

Bytes file_bytes(const std::string& name) {
  std::ifstream file(golden_path(name), std::ios::binary);
  EXPECT_TRUE(file) << golden_path(name);
  return Bytes(std::istreambuf_iterator<char>(file), {});
}

Json json_from(const Asset& a, const Sha256& id) {
  constexpr const char* kAxes[] = {"unknown", "x", "y", "z"};
  Json rows = Json::array();
  for (std::uint32_t i = 0; i < a.vertex_count; ++i) {
    std::vector<float> row(a.rank);
    a.copy_row(i, row);
    rows.push_back(std::vector<double>(row.begin(), row.end()));
  }
  Json levels = Json::array();
  for (const auto& [level, rms, largest] : a.level_errors) levels.push_back(Json::array({level, rms, largest}));
  return {{"id", id.hex()},
          {"n", a.vertex_count},
          {"r", a.rank},
          {"q", a.base_count},
          {"F", a.face_total},
          {"band_ends", a.band_ends},
          {"up_axis", kAxes[static_cast<int>(a.up_axis)]},
          {"handedness", a.handedness == Asset::Handedness::kLeft ? "left" : "right"},
          {"metres_per_unit", a.metres_per_unit},
          {"area", a.area},
          {"box_low", a.box_low},
          {"box_high", a.box_high},
          {"origin", a.origin},
          {"basis_kind", a.basis_kind},
          {"operator_kind", a.operator_kind},
          {"level_errors", levels},
          {"name", a.name},
          {"rest", a.rest},
          {"map", a.map},
          {"source_vertex", a.source_vertex},
          {"mass", std::vector<double>(a.mass.begin(), a.mass.end())},
          {"faces", a.faces},
          {"death", a.death},
          {"basis", rows}};
}

void write_golden(const std::string& folder, const EncodedAsset& encoded, const Asset& asset) {
  const auto write = [&](const std::string& name, const Bytes& bytes) {
    std::ofstream(golden_path(folder + name), std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<long>(bytes.size()));
  };
  write("manifest.bin", encoded.manifest.bytes);
  for (std::size_t c = 0; c < encoded.chunks.size(); ++c)
    write("chunk" + std::to_string(c) + ".bin", encoded.chunks[c].bytes);
  std::ofstream(golden_path(folder + "golden.json")) << json_from(asset, encoded.manifest.id).dump() << '\n';
}

const AssetEncoding kGoldenEncoding{.exact_columns = 4, .first_chunk_rows = 16};
const AssetEncoding kSmoothEncoding{.exact_columns = 4, .first_chunk_rows = 48};

void expect_golden_bytes(const std::string& folder, const EncodedAsset& encoded) {
  EXPECT_EQ(encoded.manifest.bytes, file_bytes(folder + "manifest.bin"));
  ASSERT_EQ(encoded.chunks.size(), 3u);
  for (std::size_t c = 0; c < 3; ++c)
    EXPECT_EQ(encoded.chunks[c].bytes, file_bytes(folder + "chunk" + std::to_string(c) + ".bin"));
}

TEST(AssetGolden, EncodesToTheGoldenBytes) {
  const Asset asset = golden_asset();
  const auto encoded = encode_asset(asset, kGoldenEncoding);
  ASSERT_TRUE(encoded) << encoded.error().message;
  if (std::getenv("EIGENCAST_WRITE_GOLDEN") != nullptr) write_golden("asset/", *encoded, asset);
  expect_golden_bytes("asset/", *encoded);
}

/// Multiples of a power of two.
ColumnValues golden_columns(const Asset& asset) {
  ColumnValues columns{{}, {0.0625F, 0.125F}};
  for (std::uint32_t i = 0; i < 2 * asset.vertex_count; ++i)
    columns.values.push_back(columns.scales[i % 2] * (static_cast<float>((i * 2654435761U) >> 26) - 32.0F));
  return columns;
}

TEST(AssetGolden, ColumnsAreTheGoldenBytes) {
  const auto encoded = encode_asset(golden_asset(), kGoldenEncoding);
  ASSERT_TRUE(encoded) << encoded.error().message;
  const auto asset = decode_asset(*encoded);
  ASSERT_TRUE(asset) << asset.error().message;
  const auto columns = encode_columns(*asset, *encoded, golden_columns(*asset));
  ASSERT_TRUE(columns) << columns.error().message;
  const auto wider = with_columns(*asset, columns->section.bytes, std::vector<std::uint32_t>{16, 32, 42});
  ASSERT_TRUE(wider) << wider.error().message;
  const Json read = json_from(*wider, columns->manifest.id);
  if (std::getenv("EIGENCAST_WRITE_GOLDEN") != nullptr) {
    for (const auto& [name, object] : {std::pair{"columns", columns->section}, {"columns_manifest", columns->manifest}})
      std::ofstream(golden_path(std::string("asset/") + name + ".bin"), std::ios::binary)
          .write(reinterpret_cast<const char*>(object.bytes.data()), static_cast<long>(object.bytes.size()));
    std::ofstream(golden_path("asset/columns.json")) << read.dump() << '\n';
  }
  EXPECT_EQ(columns->section.bytes, file_bytes("asset/columns.bin"));
  EXPECT_EQ(columns->manifest.bytes, file_bytes("asset/columns_manifest.bin"));
  EXPECT_EQ(read, Json::parse(std::ifstream(golden_path("asset/columns.json"))));
}

/// The asset that a folder's bytes hold, compared with its golden.json.
Asset read_golden(const std::string& folder) {
  EncodedAsset encoded;
  const std::ifstream text(golden_path(folder + "golden.json"));
  std::stringstream buffer;
  buffer << text.rdbuf();
  const Json expected = Json::parse(buffer.str());
  encoded.manifest = {*Sha256::from_hex(expected.at("id").get<std::string>()), file_bytes(folder + "manifest.bin")};
  for (std::size_t c = 0; c < 3; ++c) {
    Bytes bytes = file_bytes(folder + "chunk" + std::to_string(c) + ".bin");
    encoded.chunks.push_back({sha256(bytes), std::move(bytes)});
  }
  auto decoded = decode_asset(encoded);
  if (!decoded) {
    ADD_FAILURE() << decoded.error().message;
    return {};
  }
  const Json read = json_from(*decoded, encoded.manifest.id);
  for (const auto& [key, value] : expected.items()) EXPECT_EQ(read.at(key), value) << key;
  EXPECT_EQ(read.size(), expected.size());
  return std::move(*decoded);
}

TEST(AssetGolden, DecodesToTheExpectedArrays) {
  read_golden("asset/");
}

TEST(AssetGolden, SmoothAssetsRoundTripToTheirBytes) {
  if (std::getenv("EIGENCAST_WRITE_GOLDEN") != nullptr) {
    const auto encoded = encode_asset(smooth_asset(), kSmoothEncoding);
    ASSERT_TRUE(encoded);
    write_golden("asset_smooth/", *encoded, decode_asset(*encoded).value());
  }
  const Asset asset = read_golden("asset_smooth/");
  const auto again = encode_asset(asset, kSmoothEncoding);
  ASSERT_TRUE(again);
  expect_golden_bytes("asset_smooth/", *again);
}

}  // namespace
}  // namespace eigencast
