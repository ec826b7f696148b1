// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <vector>

#include "common/core/result.h"
#include "common/surface/formats/gltf_file.h"

/// Private to common/surface.
namespace eigencast {

/// Numbers out of a file's buffers, of any accessor: sparse, quantised, empty. Checks each index, length, offset and
/// stride before use, and bounds the total. Not thread-safe; keeps a reference.
class GltfNumbers {
 public:
  explicit GltfNumbers(const tinygltf::Model& model) : model_(model) {}

  struct Array {
    std::size_t count = 0;
    std::size_t width = 0;       ///< Components of an element.
    std::vector<double> values;  ///< count x width, finite.
  };
  /// An accessor whose elements have one of two widths (16: a matrix by columns). Normalised integers are scaled.
  /// Errors: kCorrupt, kTooLarge.
  Result<Array> read(int accessor, std::size_t width, std::size_t other_width = 0);
  /// A SCALAR accessor of unsigned integers. Errors: as above.
  Result<std::vector<std::uint32_t>> read_indices(int accessor);
  /// 0: no such accessor.
  std::size_t count(int accessor) const;
  /// Errors: kCorrupt.
  Result<std::vector<std::uint8_t>> bytes_of_view(int view) const;

 private:
  struct Span {
    const char* data = nullptr;
    std::size_t stride = 0;
  };
  Result<Span> span(int view, std::uint64_t offset, std::uint64_t count, std::size_t element_bytes) const;
  Result<void> apply_sparse(const tinygltf::Accessor& accessor, std::size_t element_bytes, Array& array) const;

  const tinygltf::Model& model_;
  std::uint64_t values_left_ = std::uint64_t{1} << 27;
};

}  // namespace eigencast
