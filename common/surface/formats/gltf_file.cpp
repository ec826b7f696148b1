// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_file.h"

#include <algorithm>
#include <exception>
#include <filesystem>
#include <new>
#include <system_error>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/scalars.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxJsonBytes = std::size_t{256} << 20;
constexpr int kMaxNesting = 64;
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;

/// Those whose absence changes nothing that is read here.
constexpr std::string_view kKnownExtensions[] = {"KHR_mesh_quantization",
                                                 "KHR_texture_transform",
                                                 "KHR_materials_unlit",
                                                 "KHR_lights_punctual",
                                                 "KHR_materials_ior",
                                                 "KHR_materials_clearcoat",
                                                 "KHR_materials_transmission",
                                                 "KHR_materials_volume",
                                                 "KHR_materials_specular",
                                                 "KHR_materials_sheen",
                                                 "KHR_materials_iridescence",
                                                 "KHR_materials_anisotropy",
                                                 "KHR_materials_dispersion",
                                                 "KHR_materials_variants",
                                                 "KHR_materials_emissive_strength",
                                                 "KHR_materials_pbrSpecularGlossiness"};

Result<std::string_view> json_of(std::string_view bytes, bool binary) {
  if (!binary) return bytes;
  if (bytes.size() < 20) return fail(ErrorCode::kCorrupt, "the file ends in its header");
  const auto word = [&bytes](std::size_t at) { return scalar_at<std::uint32_t>(bytes.data() + at); };
  if (word(4) != 2)
    return fail(ErrorCode::kUnsupported, "glTF version " + std::to_string(word(4)) + "; version 2 can be read");
  const std::uint64_t length = word(8);
  const std::uint64_t json_bytes = word(12);
  const std::uint64_t json_end = 20 + json_bytes;
  if (length > bytes.size() || json_end > length || word(16) != kJsonChunk || json_bytes % 4 != 0) {
    return fail(ErrorCode::kCorrupt,
                "its chunks do not fit the " + std::to_string(bytes.size()) + " bytes of the file");
  }
  if (json_end < length) {
    const bool fits = json_end + 8 <= length && json_end + 8 + word(static_cast<std::size_t>(json_end)) <= length;
    if (!fits) return fail(ErrorCode::kCorrupt, "its binary chunk goes beyond the end of the file");
  }
  return bytes.substr(20, static_cast<std::size_t>(json_bytes));
}

Result<void> check_json(std::string_view json) {
  if (json.size() > kMaxJsonBytes) return fail(ErrorCode::kTooLarge, "more than 256 MiB of JSON");
  int depth = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < json.size(); ++i) {
    const char c = json[i];
    if (in_string) {
      if (c == '\\') ++i;
      in_string = c != '"';
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      if (++depth > kMaxNesting)
        return fail(ErrorCode::kCorrupt, "JSON nested deeper than " + std::to_string(kMaxNesting));
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return {};
}

struct Folder {
  fs::path path;  ///< Canonical; empty: nothing.

  bool holds(const std::string& name) const { return text::is_file_below(path.string(), name); }
};

bool file_exists(const std::string& name, void* folder) {
  return static_cast<const Folder*>(folder)->holds(name);
}

bool read_file(std::vector<unsigned char>* out, std::string* error, const std::string& name, void* folder) {
  if (!static_cast<const Folder*>(folder)->holds(name)) return false;
  const auto bytes = text::bytes_of_file(name);
  if (!bytes) {
    if (error != nullptr) *error += bytes.error().message;
    return false;
  }
  out->assign(bytes->begin(), bytes->end());
  return true;
}

// Bytes in a buffer view have not been checked when this is called; they are taken from there later.
bool keep_image(tinygltf::Image* image, int, std::string*, std::string*, int, int, const unsigned char* bytes, int size,
                void*) {
  if (image->bufferView < 0 && size > 0) image->image.assign(bytes, bytes + size);
  return true;
}

Result<void> check_extensions(const tinygltf::Model& model) {
  for (const std::string& name : model.extensionsRequired) {
    if (std::find(std::begin(kKnownExtensions), std::end(kKnownExtensions), name) != std::end(kKnownExtensions))
      continue;
    return fail(ErrorCode::kUnsupported,
                "it needs the extension " + text::quoted(name) + "; export it without compression");
  }
  return {};
}

}  // namespace

Result<tinygltf::Model> gltf_model_from_bytes(std::string_view bytes, const std::string& folder) {
  const bool binary = bytes.substr(0, 4) == "glTF";
  const auto json = json_of(bytes, binary);
  if (!json) return json.error();
  if (const auto sound = check_json(*json); !sound) return sound.error();

  std::error_code code;
  Folder allowed{folder.empty() ? fs::path() : fs::canonical(folder, code)};
  tinygltf::TinyGLTF loader;
  loader.SetFsCallbacks(
      {file_exists, [](const std::string& name, void*) { return name; }, read_file, nullptr, &allowed});
  loader.SetImageLoader(keep_image, nullptr);
  tinygltf::Model model;
  std::string error;
  std::string warning;
  try {
    const auto* data = reinterpret_cast<const unsigned char*>(bytes.data());
    const auto size = static_cast<unsigned int>(bytes.size());
    const std::string base = allowed.path.string();
    const bool loaded = binary ? loader.LoadBinaryFromMemory(&model, &error, &warning, data, size, base)
                               : loader.LoadASCIIFromString(&model, &error, &warning, bytes.data(), size, base);
    if (!loaded)
      return fail(ErrorCode::kCorrupt,
                  "not a glTF file" + (error.empty() ? "" : ": " + error.substr(0, error.find('\n'))));
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::kTooLarge, "not enough memory for the file");
  } catch (const std::exception& e) {
    return fail(ErrorCode::kCorrupt, std::string("tinygltf: ") + e.what());
  }
  if (const auto known = check_extensions(model); !known) return known.error();
  return model;
}

}  // namespace eigencast
