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

namespace eigencast {
namespace {

/// Null, with errno, where none can be made.
std::FILE* temporary_file() {
  std::error_code code;
  std::string name = (std::filesystem::temp_directory_path(code) / "eigencast-coefficients-XXXXXX").string();
  const int descriptor = code ? -1 : ::mkstemp(name.data());
  if (descriptor < 0) return nullptr;
  ::unlink(name.c_str());
  return ::fdopen(descriptor, "w+");
}

}  // namespace

Result<CoefficientStore> CoefficientStore::create(std::size_t frames, std::size_t values,
                                                  std::uint64_t max_bytes_in_memory) {
  const std::uint64_t bytes = std::uint64_t{frames} * values * sizeof(double);
  if (bytes <= max_bytes_in_memory) {
    CoefficientStore store(values, {nullptr, &std::fclose});
    store.memory_.resize(frames * values);
    return store;
  }
  if (bytes > kMaxBytesOnDisk) {
    return fail(ErrorCode::kTooLarge, std::to_string(bytes >> 20) + " MiB of coefficients; at most " +
                                          std::to_string(kMaxBytesOnDisk >> 20) + " are kept");
  }
  File file(temporary_file(), &std::fclose);
  if (!file)
    return fail(ErrorCode::kIo, std::string("no temporary file can be made: ") + std::strerror(errno) +
                                    "; name another folder in TMPDIR");
  return CoefficientStore(values, std::move(file));
}

bool CoefficientStore::seek(std::size_t frame) const {
  return ::fseeko(file_.get(), static_cast<off_t>(frame * values_ * sizeof(double)), SEEK_SET) == 0;
}

Result<void> CoefficientStore::put(std::size_t frame, const std::vector<double>& C) {
  assert(C.size() == values_);
  if (!on_disk()) {
    std::copy(C.begin(), C.end(), memory_.begin() + static_cast<std::ptrdiff_t>(frame * values_));
    return {};
  }
  if (seek(frame) && std::fwrite(C.data(), sizeof(double), values_, file_.get()) == values_ &&
      std::fflush(file_.get()) == 0)
    return {};
  return fail(ErrorCode::kIo, std::string("the temporary file of coefficients cannot be written: ") +
                                  std::strerror(errno) + "; name a folder with more room in TMPDIR");
}

Result<std::vector<double>> CoefficientStore::at(std::size_t frame) const {
  std::vector<double> C(values_);
  if (!on_disk()) {
    std::copy_n(memory_.begin() + static_cast<std::ptrdiff_t>(frame * values_), values_, C.begin());
    return C;
  }
  if (seek(frame) && std::fread(C.data(), sizeof(double), values_, file_.get()) == values_) return C;
  return fail(ErrorCode::kIo, "the temporary file of coefficients cannot be read");
}

}  // namespace eigencast
