// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "common/core/result.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// Brokers believe no greater one of others: those who follow must find some above.
inline constexpr std::uint32_t kMaxForeignEpoch = UINT32_MAX - (1u << 20);

/// Generates growing epochs, across restarts as well: blocks are reserved ahead. An epoch is at least the number
/// of seconds since 2026-01-01, so epochs also grow across brokers whose wall clocks agree, and where the disk is full:
/// what could not be reserved is given all the same. Not thread-safe.
class EpochSource {
 public:
  /// Stores the end of a block for the next run, then calls reserved(); now or later.
  using Reserve = std::function<void(std::uint32_t end)>;

  /// `end`: of the blocks of earlier runs.
  EpochSource(std::uint32_t end, Reserve reserve) : last_(end), end_(end), reserve_(std::move(reserve)) {}

  /// The next epoch, also greater than `above`. Errors: kTooLarge (none is left).
  Result<std::uint32_t> next(std::uint64_t unix_seconds, std::uint32_t above = 0);
  /// Epochs to come are greater than `seen`, one of another broker, unless it is too far ahead of the clock to be true.
  void note(std::uint64_t unix_seconds, std::uint32_t seen);
  /// Call once a second: reserves ahead of the clock too, and tries again what failed.
  void reserve_ahead(std::uint64_t unix_seconds);
  void reserved(bool stored);

 private:
  std::uint32_t last_;
  std::uint32_t end_;
  std::optional<std::uint32_t> wanted_;  ///< The end of the block that is being reserved.
  bool failed_ = false;                  ///< The last try: the next one waits for reserve_ahead().
  Reserve reserve_;
};

/// Where to go on if what earlier runs reserved is lost: a block above the clock.
std::uint32_t epochs_end_by_time(std::uint64_t unix_seconds);

/// The number that a file of EpochSource's holds. Nothing: it is empty, torn or foreign.
std::optional<std::uint32_t> epoch_from_text(std::string_view text);

/// A sender shows that a stream is its own by the secret of the stream's last epoch, which it alone was given. Brokers
/// keep and exchange proofs of secrets (see resume_proof()).
struct Resume {
  std::string shown;   ///< Proof of what the sender announced with; empty: no secret.
  std::string issued;  ///< Proof of the secret of the epoch that it asks for.
};

/// In constant time. False if either is empty.
bool is_same_proof(std::string_view a, std::string_view b);

/// Decides which sender owns a stream and assigns epochs to its announcements, for one broker or several together.
class Ownership {
 public:
  using Granted = std::function<void(Result<std::uint32_t>)>;

  virtual ~Ownership() = default;
  /// Calls `granted` once, now or later, on the event loop, with an epoch greater than any earlier one of the stream;
  /// or never, if the stream is claimed again before.
  /// Errors: kRefused (the stream has a sender at another broker, and `resume` shows nothing of it), kIo.
  virtual void claim(const std::string& stream, const control::Announce& announce, const Resume& resume,
                     Granted granted) = 0;
  /// For the sender that has the stream already, which goes on: an epoch as of claim(). Errors: kIo.
  virtual Result<std::uint32_t> next_epoch(const std::string& stream) = 0;
};

class SoleOwnership final : public Ownership {
 public:
  explicit SoleOwnership(std::function<Result<std::uint32_t>()> next_epoch) : next_epoch_(std::move(next_epoch)) {}
  void claim(const std::string&, const control::Announce&, const Resume&, Granted granted) override {
    granted(next_epoch_());
  }
  Result<std::uint32_t> next_epoch(const std::string&) override { return next_epoch_(); }

 private:
  std::function<Result<std::uint32_t>()> next_epoch_;
};

}  // namespace eigencast::broker
