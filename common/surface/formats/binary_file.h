// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>

#include "common/core/files.h"
#include "common/core/result.h"

/// Numbers in the bytes of files. Private to common/surface.
namespace eigencast {

static_assert(std::endian::native == std::endian::little, "values are copied from the file as they are");

/// The T whose bytes start at `bytes`, which need not be aligned.
template <typename T, bool big_endian = false>
T scalar_at(const char* bytes) {
  std::array<char, sizeof(T)> copy;
  std::memcpy(copy.data(), bytes, sizeof(T));
  if (big_endian) std::reverse(copy.begin(), copy.end());
  return std::bit_cast<T>(copy);
}

/// A regular file that is read, never mapped: one that shrinks is an error and not a signal. Thread-safe.
class BinaryFile {
 public:
  /// Errors: kNotFound, kIo (also for anything but a regular file).
  static Result<std::shared_ptr<const BinaryFile>> open(const std::string& path);
  const std::string& path() const { return path_; }
  std::uint64_t bytes() const { return bytes_; }
  /// Fills `into` with the bytes from `offset` on. Errors: kIo, naming the file.
  Result<void> read_at(std::uint64_t offset, std::string& into) const;

 private:
  BinaryFile(FileHandle file, std::string path, std::uint64_t bytes)
      : file_(std::move(file)), path_(std::move(path)), bytes_(bytes) {}

  FileHandle file_;
  std::string path_;
  std::uint64_t bytes_;
};

}  // namespace eigencast
