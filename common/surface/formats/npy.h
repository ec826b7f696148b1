// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/formats/binary_file.h"
#include "common/surface/surface.h"

/// NumPy's array files (format 1.0 to 3.0) of real numbers, either order, either byte order. Private to common/surface.
namespace eigencast {

/// An array whose size fits its header: positions (n, 3), (T, n, 3) or faces (F, 3). Copyable; not thread-safe.
class NpyFile {
 public:
  /// Errors: kNotFound, kIo, kCorrupt, kUnsupported (complex, text, objects, more than three dimensions).
  static Result<NpyFile> open(const std::string& path);

  const std::vector<std::size_t>& shape() const { return shape_; }

  /// Pose `frame`, finite. In Fortran order, where a pose is scattered over the file, some frames are read and kept
  /// together, at most 32 MiB. REQUIRES: the last dimension is 3. Errors: kIo, kCorrupt, kUnsupported (no float type).
  Result<std::vector<Vec3>> read_positions(std::size_t frame) const;

  /// All rows of an (F, 3) array of indices. Errors: kIo, kCorrupt (negative, too large), kUnsupported.
  Result<std::vector<Face>> read_faces() const;

 private:
  struct Type {
    double (*real)(const char*) = nullptr;          ///< For float types.
    std::uint64_t (*index)(const char*) = nullptr;  ///< For integer types: a negative one is huge.
    std::size_t bytes = 0;
  };
  /// Consecutive frames of a Fortran-ordered file, value by value: (3 n) x count.
  struct Block {
    std::size_t first = 0, count = 0;
    std::string bytes;
  };
  static Result<Type> type_from_descr(std::string_view descr);
  std::size_t frames() const { return shape_.size() == 3 ? shape_[0] : 1; }
  std::size_t rows() const { return shape_[shape_.size() - 2]; }
  Result<void> read_block(std::size_t frame) const;

  std::shared_ptr<const BinaryFile> file_;
  Type type_;
  bool fortran_ = false;
  std::vector<std::size_t> shape_;
  std::uint64_t data_offset_ = 0;
  mutable Block block_;
};

}  // namespace eigencast
