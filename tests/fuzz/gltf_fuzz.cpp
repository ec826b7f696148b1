// SPDX-License-Identifier: MIT
#include "common/spectral/known_motion.h"
#include "common/surface/formats/gltf.h"
#include "tests/fuzz/clip_bytes.h"

using namespace eigencast;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const auto clip = gltf_clip_from_bytes(bytes, "", "fuzz", {});
  check_clip(clip);
  if (!clip) return 0;
  // The rig must be what a basis can be made of.
  const Rig& rig = *(*clip)->rig();
  const std::size_t n = (*clip)->rest().vertex_count();
  if (rig.bind.size() != n || rig.first_influence.size() != n + 1 ||
      rig.first_influence.back() != rig.influences.size())
    std::abort();
  for (const Rig::Influence& influence : rig.influences) {
    if (influence.bone >= rig.bones.size()) std::abort();
  }
  if (n * rig.bones.size() <= 100'000) {
    const auto columns = columns_from_rig(rig);
    if (columns && columns->W.size() != n * columns->count) std::abort();
  }
  const std::size_t faces = (*clip)->rest().faces.size();
  const Appearance& appearance = *(*clip)->appearance();
  if (appearance.face_material.size() != faces ||
      (!appearance.corner_uv.empty() && appearance.corner_uv.size() != faces) ||
      (!appearance.corner_colour.empty() && appearance.corner_colour.size() != faces))
    std::abort();
  return 0;
}
