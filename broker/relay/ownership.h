// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>

#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// Decides which sender owns a stream and assigns epochs to its announcements, for one broker or several together.
class Ownership {
 public:
  using Granted = std::function<void(Result<std::uint32_t>)>;

  virtual ~Ownership() = default;
  /// Calls `granted` once, now or later, on the event loop: with an epoch greater than any earlier one of the stream, or
  /// with the error. Errors: kRefused (the stream has a sender at another broker), kIo.
  virtual void claim(const std::string& stream, const control::Announce& announce, Granted granted) = 0;
};

/// For a single broker: the sender that claimed the stream owns it.
class SoleOwnership final : public Ownership {
 public:
  explicit SoleOwnership(std::function<Result<std::uint32_t>()> next_epoch) : next_epoch_(std::move(next_epoch)) {}
  void claim(const std::string&, const control::Announce&, Granted granted) override { granted(next_epoch_()); }

 private:
  std::function<Result<std::uint32_t>()> next_epoch_;
};

}  // namespace eigencast::broker
