// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>

#include "common/core/result.h"

namespace eigencast::broker {

/// Generates growing epochs: within a run, across restarts (the highest one is kept in a file) and, if their wall clocks
/// agree, across brokers, because an epoch is at least the number of seconds since 2026-01-01. Not thread-safe.
class EpochSource {
 public:
  static Result<EpochSource> open(std::string path);

  /// The next epoch, also greater than `above`. Errors: kIo (it could not be stored).
  Result<std::uint32_t> next(std::uint64_t unix_seconds, std::uint32_t above = 0);

 private:
  EpochSource(std::string path, std::uint32_t last) : path_(std::move(path)), last_(last) {}
  std::string path_;
  std::uint32_t last_;
};

}  // namespace eigencast::broker
