// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>

#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// Generates growing epochs, across restarts as well: a file keeps the highest one. An epoch is at least the number of
/// seconds since 2026-01-01, so epochs also grow across brokers whose wall clocks agree. Not thread-safe.
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

/// Decides which sender owns a stream and assigns epochs to its announcements, for one broker or several together.
class Ownership {
 public:
  using Granted = std::function<void(Result<std::uint32_t>)>;

  virtual ~Ownership() = default;
  /// Calls `granted` once, now or later, on the event loop, with an epoch greater than any earlier one of the stream.
  /// Errors: kRefused (the stream has a sender at another broker), kIo.
  virtual void claim(const std::string& stream, const control::Announce& announce, Granted granted) = 0;
};

class SoleOwnership final : public Ownership {
 public:
  explicit SoleOwnership(std::function<Result<std::uint32_t>()> next_epoch) : next_epoch_(std::move(next_epoch)) {}
  void claim(const std::string&, const control::Announce&, Granted granted) override { granted(next_epoch_()); }

 private:
  std::function<Result<std::uint32_t>()> next_epoch_;
};

}  // namespace eigencast::broker
