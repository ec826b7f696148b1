// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_file.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <filesystem>
#include <limits>
#include <new>
#include <system_error>

#include "common/surface/formats/binary_file.h"
#include "common/surface/formats/file_text.h"

namespace eigencast {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxJsonBytes = std::size_t{256} << 20;
constexpr int kMaxNesting = 64;
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;

/// Extensions whose absence changes nothing that is read here.
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

template <typename T, bool normalised>
double number_at(const char* bytes) {
  const T value = scalar_at<T>(bytes);
  if constexpr (normalised) {
    return std::max(-1.0, static_cast<double>(value) / static_cast<double>(std::numeric_limits<T>::max()));
  }
  return static_cast<double>(value);
}

using Reader = double (*)(const char*);

Reader reader_of(int component_type, bool normalised) {
  switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
      return normalised ? number_at<std::int8_t, true> : number_at<std::int8_t, false>;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
      return normalised ? number_at<std::uint8_t, true> : number_at<std::uint8_t, false>;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
      return normalised ? number_at<std::int16_t, true> : number_at<std::int16_t, false>;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
      return normalised ? number_at<std::uint16_t, true> : number_at<std::uint16_t, false>;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
      return number_at<std::uint32_t, false>;
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
      return number_at<float, false>;
    default:
      return nullptr;
  }
}

std::size_t bytes_of_type(int component_type) {
  const int bytes = tinygltf::GetComponentSizeInBytes(static_cast<std::uint32_t>(component_type));
  return bytes > 0 ? static_cast<std::size_t>(bytes) : 0;
}

bool is_index_type(int component_type) {
  return component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
         component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
         component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
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

std::size_t GltfNumbers::count(int accessor) const {
  const tinygltf::Accessor* found = element(model_.accessors, accessor);
  return found != nullptr ? found->count : 0;
}

Result<std::vector<std::uint8_t>> GltfNumbers::bytes_of_view(int view) const {
  const tinygltf::BufferView* found = element(model_.bufferViews, view);
  const std::size_t length = found != nullptr ? found->byteLength : 0;
  const auto bytes = span(view, 0, length, 1);
  if (!bytes) return bytes.error();
  return std::vector<std::uint8_t>(bytes->data, bytes->data + length);
}

Result<GltfNumbers::Span> GltfNumbers::span(int view_index, std::uint64_t offset, std::uint64_t count,
                                            std::size_t element_bytes) const {
  const std::string name = "buffer view " + std::to_string(view_index);
  const tinygltf::BufferView* view = element(model_.bufferViews, view_index);
  if (view == nullptr) return corrupt_gltf("no " + name);
  const tinygltf::Buffer* buffer = element(model_.buffers, view->buffer);
  if (buffer == nullptr) return corrupt_gltf(name + " lies in no buffer");
  const std::vector<unsigned char>& bytes = buffer->data;
  if (view->byteOffset > bytes.size() || view->byteLength > bytes.size() - view->byteOffset) {
    return corrupt_gltf(name + " goes beyond its buffer of " + std::to_string(bytes.size()) + " bytes");
  }
  const std::size_t stride = view->byteStride > 0 ? view->byteStride : element_bytes;
  if (stride < element_bytes || stride > 65'536)
    return corrupt_gltf(name + " has a stride of " + std::to_string(stride));
  // count * stride cannot overflow once count is at most the view's length.
  const bool fits = offset <= view->byteLength && count <= view->byteLength &&
                    (count == 0 || (count - 1) * stride + element_bytes <= view->byteLength - offset);
  if (!fits) return corrupt_gltf(std::to_string(count) + " elements go beyond " + name);
  return Span{reinterpret_cast<const char*>(bytes.data()) + view->byteOffset + offset, stride};
}

Result<GltfNumbers::Array> GltfNumbers::read(int index, std::size_t width, std::size_t other_width, Values values) {
  const std::string name = "accessor " + std::to_string(index);
  const tinygltf::Accessor* found = element(model_.accessors, index);
  if (found == nullptr) return corrupt_gltf("no " + name);
  const tinygltf::Accessor& accessor = *found;
  Array array;
  array.count = accessor.count;
  const int components = tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(accessor.type));
  array.width = components > 0 ? static_cast<std::size_t>(components) : 0;
  if (array.width == 0 || (array.width != width && array.width != other_width)) {
    return corrupt_gltf(name + " has elements of " + std::to_string(components) + " numbers where " +
                        std::to_string(width) + " are needed");
  }
  const Reader number = reader_of(accessor.componentType, accessor.normalized);
  const std::size_t component_bytes = bytes_of_type(accessor.componentType);
  if (number == nullptr || component_bytes == 0) return corrupt_gltf(name + " has an unknown component type");
  // Only matrices of bytes and shorts would have padding between their columns, and none is used here.
  if (array.width == 16 && component_bytes != 4) return corrupt_gltf(name + ": matrices are of 32-bit floats");
  if (array.count > values_left_ / array.width)
    return fail(ErrorCode::kTooLarge, name + ": too many numbers in the file");
  const std::size_t element_bytes = component_bytes * array.width;
  Span from;
  if (accessor.bufferView >= 0) {
    const auto good = store(from, span(accessor.bufferView, accessor.byteOffset, array.count, element_bytes));
    if (!good) return in_context(name, good.error());
  }
  values_left_ -= array.count * array.width;
  array.values.resize(array.count * array.width);
  for (std::size_t i = 0; from.data != nullptr && i < array.count; ++i) {
    for (std::size_t c = 0; c < array.width; ++c) {
      array.values[i * array.width + c] = number(from.data + i * from.stride + c * component_bytes);
    }
  }
  if (accessor.sparse.isSparse) {
    if (const auto applied = apply_sparse(accessor, element_bytes, array); !applied)
      return in_context(name, applied.error());
  }
  for (std::size_t i = 0; values == Values::kFinite && i < array.values.size(); ++i) {
    if (!std::isfinite(array.values[i]))
      return corrupt_gltf(name + ": element " + std::to_string(i / array.width) + " is not finite");
  }
  return array;
}

Result<void> GltfNumbers::apply_sparse(const tinygltf::Accessor& accessor, std::size_t element_bytes,
                                       Array& array) const {
  const auto& sparse = accessor.sparse;
  if (sparse.count < 0 || static_cast<std::size_t>(sparse.count) > array.count ||
      !is_index_type(sparse.indices.componentType) || sparse.indices.byteOffset < 0 || sparse.values.byteOffset < 0) {
    return corrupt_gltf("its sparse part cannot be meant");
  }
  const auto count = static_cast<std::size_t>(sparse.count);
  const auto indices = span(sparse.indices.bufferView, static_cast<std::uint64_t>(sparse.indices.byteOffset), count,
                            bytes_of_type(sparse.indices.componentType));
  if (!indices) return indices.error();
  const auto values =
      span(sparse.values.bufferView, static_cast<std::uint64_t>(sparse.values.byteOffset), count, element_bytes);
  if (!values) return values.error();
  const Reader index_of = reader_of(sparse.indices.componentType, false);
  const Reader number = reader_of(accessor.componentType, accessor.normalized);
  const std::size_t component_bytes = element_bytes / array.width;
  for (std::size_t k = 0; k < count; ++k) {
    const auto at = static_cast<std::size_t>(index_of(indices->data + k * indices->stride));
    if (at >= array.count) return corrupt_gltf("its sparse part names element " + std::to_string(at));
    for (std::size_t c = 0; c < array.width; ++c) {
      array.values[at * array.width + c] = number(values->data + k * values->stride + c * component_bytes);
    }
  }
  return {};
}

Result<std::vector<std::uint32_t>> GltfNumbers::read_indices(int index) {
  const tinygltf::Accessor* accessor = element(model_.accessors, index);
  if (accessor != nullptr && !is_index_type(accessor->componentType))
    return corrupt_gltf("accessor " + std::to_string(index) + ": indices are unsigned integers");
  const auto array = read(index, 1);
  if (!array) return array.error();
  std::vector<std::uint32_t> indices(array->count);
  std::transform(array->values.begin(), array->values.end(), indices.begin(),
                 [](double x) { return static_cast<std::uint32_t>(x); });
  return indices;
}

}  // namespace eigencast
