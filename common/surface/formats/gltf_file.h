// SPDX-License-Identifier: MIT
#pragma once

// tinygltf without the parts that decode and write images; this is the one place that includes it.
#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#include <tiny_gltf.h>

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

/// Private to common/surface.
namespace eigencast {

inline Error corrupt_gltf(const std::string& what) {
  return fail(ErrorCode::kCorrupt, what);
}

/// Element `index`; null where there is none.
template <typename T>
const T* element(const std::vector<T>& all, int index) {
  return index >= 0 && static_cast<std::size_t>(index) < all.size() ? &all[static_cast<std::size_t>(index)] : nullptr;
}

/// Checks a file, then lets tinygltf parse it: tinygltf trusts chunk lengths and recurses as deep as JSON nests. Images
/// are kept encoded; those in a buffer view stay there. No index in the result has been checked. Errors: kCorrupt,
/// kUnsupported (an extension that must be understood), kTooLarge.
///   folder  only files below it are read, none if it is empty
Result<tinygltf::Model> gltf_model_from_bytes(std::string_view bytes, const std::string& folder);

/// Numbers out of a file's buffers, of any accessor: sparse, quantised, empty. Checks each index, length, offset and
/// stride before use, and bounds the total. Not thread-safe; keeps a reference.
class GltfNumbers {
 public:
  explicit GltfNumbers(const tinygltf::Model& model) : model_(model) {}

  struct Array {
    std::size_t count = 0;
    std::size_t width = 0;       ///< Components of an element.
    std::vector<double> values;  ///< count x width.
  };
  enum class Values { kFinite, kAny };
  /// An accessor whose elements have one of two widths (16: a matrix by columns). Normalised integers are scaled.
  /// Errors: kCorrupt, kTooLarge.
  Result<Array> read(int accessor, std::size_t width, std::size_t other_width = 0, Values values = Values::kFinite);
  Result<std::vector<std::uint32_t>> read_indices(int accessor);    ///< SCALAR, of unsigned integers.
  std::size_t count(int accessor) const;                            ///< 0: no such accessor.
  Result<std::vector<std::uint8_t>> bytes_of_view(int view) const;  ///< Errors: kCorrupt.

 private:
  struct Span {
    const char* data = nullptr;
    std::size_t stride = 0;
  };
  Result<Span> span(int view, std::uint64_t offset, std::uint64_t count, std::size_t element_bytes) const;
  Result<void> apply_sparse(const tinygltf::Accessor& accessor, std::size_t element_bytes, Array& array) const;

  const tinygltf::Model& model_;
  std::uint64_t values_left_ = (std::uint64_t{1} << 27) + 3 * kMaxSurfaceVertices;  // these: normals
};

}  // namespace eigencast
