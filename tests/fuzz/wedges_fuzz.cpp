// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "common/asset/asset.h"
#include "common/asset/tiles/tiles.h"

using namespace eigencast;

namespace {

/// An icosahedron: what of an asset a texture is read against.
Asset icosahedron() {
  Asset asset;
  asset.vertex_count = asset.rows_ready = 12;
  asset.base_count = 4;
  asset.map = {0, 1, 2, 3, 3, 0, 2, 0, 3, 1, 0, 0};
  asset.faces = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
                 {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
                 {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
  asset.face_total = asset.faces_ready = 20;
  return asset;
}

}  // namespace

/// What is taken is sound, and the same when it is written and read again.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const Asset asset = icosahedron();
  auto texture = decode_uvs(ByteView(data, size), asset.base_count, asset.map, asset.faces);
  if (!texture) return 0;
  texture->image = {1};
  if (!validate_texture(*texture, asset)) std::abort();
  const auto again = decode_uvs(encode_uvs(*texture, asset), asset.base_count, asset.map, asset.faces);
  if (!again || again->uvs != texture->uvs || again->parent != texture->parent || again->corners != texture->corners ||
      again->first_wedge != texture->first_wedge)
    std::abort();
  return 0;
}
