// SPDX-License-Identifier: MIT
#include "common/surface/formats/foreign.h"

#include <algorithm>
#include <iterator>
#include <string_view>

#ifdef EIGENCAST_WITH_ASSIMP
#include <assimp/postprocess.h>

#include <assimp/Exporter.hpp>
#include <assimp/Importer.hpp>
#include <exception>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/gltf.h"
#endif

namespace eigencast {

constexpr std::string_view kForeign[] = {"fbx", "dae", "3ds", "x", "x3d", "blend", "ms3d", "md5mesh", "smd"};

bool is_foreign(const std::string& ending) {
  return std::find(std::begin(kForeign), std::end(kForeign), ending) != std::end(kForeign);
}

std::string foreign_endings() {
  std::string all;
#ifdef EIGENCAST_WITH_ASSIMP
  for (const std::string_view ending : kForeign) all += (all.empty() ? "" : ", ") + std::string(ending);
#endif
  return all;
}

#ifdef EIGENCAST_WITH_ASSIMP

Result<std::unique_ptr<MotionClip>> open_foreign_clip(const std::string& path, const ClipOptions& options) {
  // From memory, so that assimp follows no reference to another file.
  const auto bytes = text::bytes_of_file(path);
  if (!bytes) return bytes.error();
  try {
    Assimp::Importer importer;
    const std::string hint = text::ending_of(path);
    const aiScene* scene = importer.ReadFileFromMemory(
        bytes->data(), bytes->size(), aiProcess_Triangulate | aiProcess_JoinIdenticalVertices, hint.c_str());
    if (scene == nullptr) return fail(ErrorCode::kCorrupt, path + ": assimp: " + importer.GetErrorString());
    Assimp::Exporter exporter;
    const aiExportDataBlob* blob = exporter.ExportToBlob(scene, "glb2");
    if (blob == nullptr) return fail(ErrorCode::kUnsupported, path + ": assimp: " + exporter.GetErrorString());
    return gltf_clip_from_bytes({static_cast<const char*>(blob->data), blob->size}, "", path, options);
  } catch (const std::exception& error) {
    return fail(ErrorCode::kCorrupt, path + ": assimp: " + error.what());
  }
}

#else

Result<std::unique_ptr<MotionClip>> open_foreign_clip(const std::string& path, const ClipOptions&) {
  return fail(ErrorCode::kUnsupported,
              path + ": this build is without assimp; convert the file to GLB, or build with libassimp-dev");
}

#endif

}  // namespace eigencast
