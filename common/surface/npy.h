// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/surface.h"

/// NumPy's array files (format 1.0 to 3.0), C order, little-endian. Private to common/surface.
namespace eigencast {

/// An array in a file whose header has been read and whose size fits it. Holds no open file. Copyable, thread-safe.
class NpyFile {
 public:
  /// Errors: kNotFound, kIo, kCorrupt, kUnsupported (other types, Fortran order, more than three dimensions).
  static Result<NpyFile> open(const std::string& path);

  const std::vector<std::size_t>& shape() const { return shape_; }

  /// Rows [first, first + count) of three numbers each, where the file is looked at as (..., 3): finite positions.
  /// REQUIRES: the last dimension is 3. Errors: kIo, kCorrupt (not finite), kUnsupported (no float type).
  Result<std::vector<Vec3>> read_positions(std::size_t first, std::size_t count) const;

  /// All rows of an (F, 3) array of indices. Errors: kIo, kCorrupt (negative, too large), kUnsupported.
  Result<std::vector<Face>> read_faces() const;

 private:
  Result<std::string> read_bytes(std::size_t first_row, std::size_t rows) const;

  std::string path_;
  char kind_ = 'f';  // f, i, u as in numpy's descr
  std::size_t item_bytes_ = 4;
  std::vector<std::size_t> shape_;
  std::uint64_t data_offset_ = 0;
};

}  // namespace eigencast
