// SPDX-License-Identifier: MIT
#include "common/surface/formats/endings.h"

#include <algorithm>
#include <iterator>
#include <string_view>

namespace eigencast {
namespace {

constexpr std::string_view kFrames[] = {"obj", "off", "ply", "stl", "xyz", "npy", "pc2", "mdd"};
constexpr std::string_view kForeign[] = {"fbx", "dae", "3ds", "x", "x3d", "blend", "ms3d", "md5mesh", "smd"};

template <std::size_t N>
bool is_one_of(const std::string_view (&endings)[N], const std::string& ending) {
  return std::find(std::begin(endings), std::end(endings), ending) != std::end(endings);
}

}  // namespace

std::string readable_endings() {
  const std::string foreign = foreign_endings();
  return "obj, ply, off, stl, xyz, npy, gltf, glb, pc2" +
         (foreign.empty() ? std::string(" or mdd (built without assimp: no fbx, dae)")
                          : ", mdd, " + foreign + " (through assimp)");
}

bool is_frame_ending(const std::string& ending) {
  return is_one_of(kFrames, ending);
}
bool is_foreign(const std::string& ending) {
  return is_one_of(kForeign, ending);
}
bool is_whole_clip(const std::string& ending) {
  return ending == "gltf" || ending == "glb" || is_foreign(ending);
}

std::string foreign_endings() {
  std::string all;
#ifdef EIGENCAST_WITH_ASSIMP
  for (const std::string_view ending : kForeign) all += (all.empty() ? "" : ", ") + std::string(ending);
#endif
  return all;
}

}  // namespace eigencast
