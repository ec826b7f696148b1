// SPDX-License-Identifier: MIT
#pragma once

#include <charconv>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>

#include "common/core/result.h"

/// Private to common/surface.
namespace eigencast {

/// A file that has its name only when it is whole.
class NewFile {
 public:
  explicit NewFile(const std::string& path)
      : path_(path), part_(path + ".part"), out_(part_, std::ios::binary | std::ios::trunc) {}
  ~NewFile() {
    std::error_code ignored;
    if (!done_) std::filesystem::remove(part_, ignored);
  }
  NewFile(const NewFile&) = delete;
  NewFile& operator=(const NewFile&) = delete;

  /// Errors: kIo.
  Result<void> write(const std::string& bytes) {
    out_.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    return out_.good() ? Result<void>() : failure();
  }
  Result<void> finish() {
    out_.close();
    std::error_code code;
    if (out_) std::filesystem::rename(part_, path_, code);
    if (!out_ || code) return failure();
    done_ = true;
    return {};
  }

 private:
  Error failure() const {
    return fail(ErrorCode::kIo, path_ + ": cannot be written; is there a folder, and room in it?");
  }

  std::string path_, part_;
  std::ofstream out_;
  bool done_ = false;
};

/// The shortest text that reads back as the same number.
template <typename Number>
void append_number(std::string& text, Number value) {
  char digits[32];
  const auto [end, error] = std::to_chars(digits, digits + sizeof digits, value);
  if (error == std::errc()) text.append(digits, end);
}

}  // namespace eigencast
