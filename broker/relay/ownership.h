// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>

#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// Decides who may be the sender of a stream, and gives its announcements their epochs: a broker for itself, or several
/// brokers together. On the event loop.
class Ownership {
 public:
  using Granted = std::function<void(Result<std::uint32_t>)>;

  virtual ~Ownership() = default;
  /// Calls `granted` now or later, once: with the epoch, greater than any that the stream had, or with what is in the
  /// way. Errors: kRefused (the stream has a sender at another broker), kIo.
  virtual void claim(const std::string& stream, const control::Announce& announce, Granted granted) = 0;
};

/// A broker for itself: whoever has claimed the stream is its sender.
class SoleOwnership final : public Ownership {
 public:
  /// next_epoch  as EpochSource::next()
  explicit SoleOwnership(std::function<Result<std::uint32_t>()> next_epoch) : next_epoch_(std::move(next_epoch)) {}
  void claim(const std::string&, const control::Announce&, Granted granted) override { granted(next_epoch_()); }

 private:
  std::function<Result<std::uint32_t>()> next_epoch_;
};

}  // namespace eigencast::broker
