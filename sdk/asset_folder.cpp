// SPDX-License-Identifier: MIT
#include "sdk/asset_folder.h"

#include <cstdlib>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include "common/asset/format/reader.h"
#include "common/core/files.h"
#include "common/core/text.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace fs = std::filesystem;
namespace {

constexpr std::uint64_t kMaxCodingBytes = 64;

std::string coding_path(const std::string& folder, const Sha256& id) {
  return (fs::path(folder) / (id.hex() + ".coding")).string();
}

}  // namespace

Result<Bytes> read_object(const std::string& folder, const Sha256& id) {
  auto bytes = read_bytes((fs::path(folder) / id.hex()).string(), limits::kMaxAssetObjectBytes);
  if (bytes) return bytes;
  return fail(bytes.error().code, bytes.error().message +
                                      "; is this a folder that an asset was written to, whole, and the asset's id the "
                                      "one that its bake gave?");
}

Result<void> write_asset(const EncodedAsset& encoded, double coding_error, const std::string& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return fail(ErrorCode::kIo, folder + ": cannot be made: " + error.message());
  const auto write = [&](const AssetObject& object) {
    const std::string_view bytes(reinterpret_cast<const char*>(object.bytes.data()), object.bytes.size());
    return write_file_atomically(folder + "/" + object.id.hex(), bytes);
  };
  for (const auto* parts : {&encoded.chunks, &encoded.sections}) {
    for (const AssetObject& part : *parts) {
      if (auto written = write(part); !written) return written;
    }
  }
  if (coding_error > 0) {
    const auto path = coding_path(folder, encoded.manifest.id);
    if (auto written = write_file_atomically(path, formatted("%.17g\n", coding_error)); !written) return written;
  }
  return write(encoded.manifest);
}

Result<WholeAsset> assemble_asset(const Sha256& id, const std::function<Result<Bytes>(const Sha256& id)>& object_of) {
  auto manifest = object_of(id);
  if (!manifest) return manifest.error();
  auto reader = AssetReader::from_manifest(id, *manifest);
  if (!reader) return in_context("asset " + id.hex(), reader.error());
  WholeAsset result;
  if (const auto columns = reader->columns()) {
    auto section = object_of(columns->id);
    if (!section) return section.error();
    if (const auto added = reader->add_columns(*section); !added) return in_context("asset " + id.hex(), added.error());
    result.encoded.sections.push_back({columns->id, std::move(*section)});
  }
  for (std::size_t i = 0; i < reader->chunks().size(); ++i) {
    const Sha256 chunk_id = reader->chunks()[i].id;
    auto chunk = object_of(chunk_id);
    if (!chunk) return chunk.error();
    if (const auto added = reader->add_chunk(i, *chunk); !added) return in_context("asset " + id.hex(), added.error());
    result.encoded.chunks.push_back({chunk_id, std::move(*chunk)});
  }
  result.encoded.manifest = {id, std::move(*manifest)};
  result.asset = std::move(*reader).take();
  if (!result.asset.complete()) return fail(ErrorCode::kCorrupt, "asset " + id.hex() + " is not whole");
  return result;
}

Result<WholeAsset> read_asset(const std::string& folder, const Sha256& id) {
  auto whole = assemble_asset(id, [&](const Sha256& object) { return read_object(folder, object); });
  if (!whole) return whole;
  if (const auto text = read_file(coding_path(folder, id), kMaxCodingBytes)) {
    char* end = nullptr;
    const double error = std::strtod(text->c_str(), &end);
    if (*end == '\n' && error > 0 && error <= whole->asset.diagonal()) whole->asset.coding_error = error;
  }
  return whole;
}

}  // namespace eigencast
