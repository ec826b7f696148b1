// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <cstdio>
#include <memory>
#include <utility>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

/// Coefficients of a clip's frames: in memory while few, else in a temporary file without a name, which goes with the
/// process. Not thread-safe.
class CoefficientStore {
 public:
  static constexpr std::uint64_t kMaxBytesInMemory = std::uint64_t{64} << 20;
  static constexpr std::uint64_t kMaxBytesOnDisk = std::uint64_t{4} << 30;

  /// values: doubles a frame. Errors: kTooLarge (over kMaxBytesOnDisk); kIo (no temporary file can be made).
  static Result<CoefficientStore> create(std::size_t frames, std::size_t values,
                                         std::uint64_t max_bytes_in_memory = kMaxBytesInMemory);

  bool on_disk() const { return file_ != nullptr; }
  /// Errors: kIo (no room). REQUIRES: frame < frames, C.size() == values.
  Result<void> put(std::size_t frame, const std::vector<double>& C);
  /// Errors: kIo. REQUIRES: frame was put.
  Result<std::vector<double>> at(std::size_t frame) const;

 private:
  using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;
  CoefficientStore(std::size_t values, File file) : values_(values), file_(std::move(file)) {}
  bool seek(std::size_t frame) const;

  std::size_t values_;
  File file_;  ///< Null: in memory.
  std::vector<double> memory_;
};

}  // namespace eigencast
