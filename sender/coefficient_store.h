// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

/// Coefficients of the frames of a clip, so that playing reads and projects nothing: in memory while they are few, else
/// in a temporary file without a name, which goes with the process. Frames may be put and read in any order. Not
/// thread-safe.
class CoefficientStore {
 public:
  static constexpr std::uint64_t kMaxBytesInMemory = std::uint64_t{64} << 20;
  static constexpr std::uint64_t kMaxBytesOnDisk = std::uint64_t{4} << 30;

  /// values: doubles a frame. Errors: kTooLarge (over kMaxBytesOnDisk); kIo (no temporary file can be made).
  static Result<CoefficientStore> create(std::size_t frames, std::size_t values,
                                         std::uint64_t max_bytes_in_memory = kMaxBytesInMemory);
  ~CoefficientStore();
  CoefficientStore(CoefficientStore&& other) noexcept;
  CoefficientStore& operator=(CoefficientStore&&) = delete;

  bool on_disk() const { return descriptor_ >= 0; }
  /// Errors: kIo (no room). REQUIRES: frame < frames, C.size() == values.
  Result<void> put(std::size_t frame, const std::vector<double>& C);
  /// What was put. Errors: kIo. REQUIRES: frame was put.
  Result<std::vector<double>> at(std::size_t frame) const;

 private:
  CoefficientStore(std::size_t values, int descriptor) : values_(values), descriptor_(descriptor) {}
  std::size_t values_;
  int descriptor_;
  std::vector<double> memory_;
};

}  // namespace eigencast
