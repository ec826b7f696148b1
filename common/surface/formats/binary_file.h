// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "common/core/files.h"
#include "common/core/result.h"

/// Private to common/surface.
namespace eigencast {

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
