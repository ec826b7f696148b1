// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_accessor.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "common/surface/formats/scalars.h"

namespace eigencast {
namespace {

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
  const tinygltf::BufferView* found = element(model_.bufferViews, view_index);
  if (found == nullptr) return corrupt_gltf("no " + name);
  const tinygltf::BufferView& view = *found;
  const tinygltf::Buffer* buffer = element(model_.buffers, view.buffer);
  if (buffer == nullptr) return corrupt_gltf(name + " lies in no buffer");
  const std::vector<unsigned char>& bytes = buffer->data;
  if (view.byteOffset > bytes.size() || view.byteLength > bytes.size() - view.byteOffset) {
    return corrupt_gltf(name + " goes beyond its buffer of " + std::to_string(bytes.size()) + " bytes");
  }
  const std::size_t stride = view.byteStride > 0 ? view.byteStride : element_bytes;
  if (stride < element_bytes || stride > 65'536)
    return corrupt_gltf(name + " has a stride of " + std::to_string(stride));
  // count * stride cannot overflow once count is at most the view's length.
  const bool fits = offset <= view.byteLength && count <= view.byteLength &&
                    (count == 0 || (count - 1) * stride + element_bytes <= view.byteLength - offset);
  if (!fits) return corrupt_gltf(std::to_string(count) + " elements go beyond " + name);
  return Span{reinterpret_cast<const char*>(bytes.data()) + view.byteOffset + offset, stride};
}

Result<GltfNumbers::Array> GltfNumbers::read(int index, std::size_t width, std::size_t other_width) {
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
    const auto there = span(accessor.bufferView, accessor.byteOffset, array.count, element_bytes);
    if (!there) return in_context(name, there.error());
    from = *there;
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
  for (std::size_t i = 0; i < array.values.size(); ++i) {
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
