// SPDX-License-Identifier: MIT
#include <cassert>
#include <string>

#include "common/asset/tiles/number_coder.h"
#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

/// Neighbours are mostly alike: a row's context is the value of the one that it contracts onto, or of the one before.
std::size_t context_of(std::span<const std::uint8_t> known, std::uint32_t parent) {
  if (known.empty()) return 0;
  return parent < known.size() ? known[parent] : known.back();
}

}  // namespace

Bytes encode_normals(std::span<const std::uint8_t> normals, std::uint32_t first_row,
                     std::span<const std::uint32_t> map) {
  assert(normals.size() >= first_row + map.size());
  Bytes coded;
  NumberWriter out(coded, Asset::kNormalsValues);
  for (std::size_t k = 0; k < map.size(); ++k)
    out.pass(context_of(normals.first(first_row + k), map[k]), normals[first_row + k]);
  out.coder().finish();
  return coded;
}

Result<void> decode_normals(ByteView coded, std::span<const std::uint32_t> map, std::vector<std::uint8_t>& normals) {
  NumberReader in(coded, Asset::kNormalsValues);
  normals.reserve(normals.size() + map.size());
  for (const std::uint32_t parent : map) {
    const std::uint32_t value = in.pass(context_of(normals, parent));
    if (value >= Asset::kNormalsValues)
      return fail(ErrorCode::kCorrupt, "normals tile: row " + std::to_string(normals.size()) + " is out of its range");
    normals.push_back(static_cast<std::uint8_t>(value));
  }
  if (!in.coder().finished()) return fail(ErrorCode::kCorrupt, "normals tile: its bytes do not fit its rows");
  return {};
}

}  // namespace eigencast
