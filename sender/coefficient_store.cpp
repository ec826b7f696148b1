// SPDX-License-Identifier: MIT
#include "sender/coefficient_store.h"

#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>
#include <utility>

namespace eigencast {
namespace {

Result<int> nameless_file() {
  std::error_code code;
  const auto folder = std::filesystem::temp_directory_path(code);
  std::string name = (folder / "eigencast-coefficients-XXXXXX").string();
  const int descriptor = code ? -1 : ::mkstemp(name.data());
  if (descriptor < 0) {
    return fail(ErrorCode::kIo, "no temporary file can be made in " + folder.string() + ": " + std::strerror(errno) +
                                    "; name another folder in TMPDIR");
  }
  ::unlink(name.c_str());
  return descriptor;
}

/// Moves all bytes by calls of pread or pwrite.
template <typename Call, typename Byte>
bool move_all(const Call& call, Byte* bytes, std::size_t count, std::uint64_t offset) {
  while (count > 0) {
    const ssize_t moved = call(bytes, count, static_cast<off_t>(offset));
    if (moved < 0 && errno == EINTR) continue;
    if (moved <= 0) return false;
    bytes += moved;
    count -= static_cast<std::size_t>(moved);
    offset += static_cast<std::uint64_t>(moved);
  }
  return true;
}

}  // namespace

Result<CoefficientStore> CoefficientStore::create(std::size_t frames, std::size_t values,
                                                  std::uint64_t max_bytes_in_memory) {
  const std::uint64_t bytes = std::uint64_t{frames} * values * sizeof(double);
  if (bytes <= max_bytes_in_memory) {
    CoefficientStore store(values, -1);
    store.memory_.resize(frames * values);
    return store;
  }
  if (bytes > kMaxBytesOnDisk) {
    return fail(ErrorCode::kTooLarge, std::to_string(bytes >> 20) + " MiB of coefficients; at most " +
                                          std::to_string(kMaxBytesOnDisk >> 20) + " are kept");
  }
  const auto file = nameless_file();
  if (!file) return file.error();
  return CoefficientStore(values, *file);
}

CoefficientStore::CoefficientStore(CoefficientStore&& other) noexcept
    : values_(other.values_), descriptor_(std::exchange(other.descriptor_, -1)), memory_(std::move(other.memory_)) {}

CoefficientStore::~CoefficientStore() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

Result<void> CoefficientStore::put(std::size_t frame, const std::vector<double>& C) {
  assert(C.size() == values_);
  if (!on_disk()) {
    std::copy(C.begin(), C.end(), memory_.begin() + static_cast<std::ptrdiff_t>(frame * values_));
    return {};
  }
  const auto write = [this](const char* bytes, std::size_t count, off_t offset) {
    return ::pwrite(descriptor_, bytes, count, offset);
  };
  const std::size_t bytes = values_ * sizeof(double);
  if (move_all(write, reinterpret_cast<const char*>(C.data()), bytes, std::uint64_t{frame} * bytes)) return {};
  return fail(ErrorCode::kIo, std::string("the temporary file of coefficients cannot be written: ") +
                                  std::strerror(errno) + "; name a folder with more room in TMPDIR");
}

Result<std::vector<double>> CoefficientStore::at(std::size_t frame) const {
  std::vector<double> C(values_);
  if (!on_disk()) {
    std::copy_n(memory_.begin() + static_cast<std::ptrdiff_t>(frame * values_), values_, C.begin());
    return C;
  }
  const auto read = [this](char* into, std::size_t count, off_t offset) {
    return ::pread(descriptor_, into, count, offset);
  };
  const std::size_t bytes = values_ * sizeof(double);
  if (move_all(read, reinterpret_cast<char*>(C.data()), bytes, std::uint64_t{frame} * bytes)) return C;
  return fail(ErrorCode::kIo, "the temporary file of coefficients cannot be read");
}

}  // namespace eigencast
