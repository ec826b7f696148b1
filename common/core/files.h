// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

#include "common/core/bytes.h"
#include "common/core/result.h"

namespace eigencast {

/// Owns a file descriptor.
class FileHandle {
 public:
  explicit FileHandle(int fd = -1) : fd_(fd) {}
  ~FileHandle();
  FileHandle(FileHandle&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FileHandle& operator=(FileHandle&& other) noexcept;
  int get() const { return fd_; }

 private:
  int fd_;
};

/// The whole content of a file or a pipe. Errors, which name the path: kNotFound (it cannot be opened), kIo (a folder,
/// or reading fails), kTooLarge (over max_bytes).
Result<std::string> read_file(const std::string& path, std::uint64_t max_bytes);
Result<Bytes> read_bytes(const std::string& path, std::uint64_t max_bytes);

/// Writes a file so that a reader sees the old or the new content, never a part: under a temporary name in the same
/// folder, then renamed. A device, a pipe or a link (/dev/stdout is one) is written to as it is. One writer per path at
/// a time. `synced`: also after a loss of power. Errors: kIo; nothing is left behind then.
Result<void> write_file_atomically(const std::string& path, std::string_view content, bool synced = false);

/// Whether a file could be written there, as far as can be found without doing it. Empty: none is wanted. Errors: kIo.
Result<void> check_output_file(const std::string& path);
/// Whether files could be written into a folder, which may have to be made. Errors: kIo.
Result<void> check_output_folder(const std::string& path);

}  // namespace eigencast
