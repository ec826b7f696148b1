// SPDX-License-Identifier: MIT
#include "broker/relay/ownership.h"

#include <algorithm>
#include <charconv>

namespace eigencast::broker {
namespace {

constexpr std::uint64_t kStartOf2026 = 1'767'225'600;
constexpr std::uint64_t kMaxEpoch = UINT32_MAX;
constexpr std::uint64_t kBlock = 1024;
constexpr std::uint64_t kMaxAhead = 1u << 20;  ///< Of the clock: 12 days, as clocks may differ.
constexpr std::uint64_t kRenewAfter = 64;      ///< Epochs or seconds: the block then lasts for many tries.

/// A wrong clock leaves half of all epochs.
std::uint64_t epoch_by_time(std::uint64_t unix_seconds) {
  return unix_seconds > kStartOf2026 ? std::min(unix_seconds - kStartOf2026, kMaxEpoch / 2) : 0;
}

/// Not invented by a broker that lies.
bool is_plausible(std::uint32_t epoch, std::uint64_t unix_seconds) {
  return epoch <= epoch_by_time(unix_seconds) + kMaxAhead;
}

}  // namespace

void EpochSource::note(std::uint64_t unix_seconds, std::uint32_t seen) {
  if (is_plausible(seen, unix_seconds)) last_ = std::max(last_, seen);
}

Result<std::uint32_t> EpochSource::next(std::uint64_t unix_seconds, std::uint32_t above) {
  const std::uint64_t epoch = std::max(std::uint64_t{std::max(last_, above)} + 1, epoch_by_time(unix_seconds));
  if (epoch > kMaxEpoch) {
    return fail(ErrorCode::kTooLarge, "this broker has no epoch above " + std::to_string(kMaxEpoch) +
                                          ": ask its operator to start it with a new data folder");
  }
  // An epoch that another broker invents is for its stream: it must not use up those of this broker.
  last_ = is_plausible(above, unix_seconds) ? static_cast<std::uint32_t>(epoch) : last_ + 1;
  if (!failed_) reserve_ahead(unix_seconds);
  return static_cast<std::uint32_t>(epoch);
}

void EpochSource::reserve_ahead(std::uint64_t unix_seconds) {
  const std::uint64_t used = std::max<std::uint64_t>(last_, epoch_by_time(unix_seconds));
  const std::uint64_t end = std::min(used + kBlock, kMaxEpoch);
  if (wanted_ || end < std::min(end_ + kRenewAfter, kMaxEpoch)) return;
  wanted_ = static_cast<std::uint32_t>(end);
  reserve_(*wanted_);
}

void EpochSource::reserved(bool stored) {
  failed_ = !stored;
  if (stored) end_ = *wanted_;
  wanted_.reset();
}

std::uint32_t epochs_end_by_time(std::uint64_t unix_seconds) {
  return static_cast<std::uint32_t>(epoch_by_time(unix_seconds) + kBlock);
}

bool is_same_proof(std::string_view a, std::string_view b) {
  if (a.empty() || a.size() != b.size()) return false;
  volatile unsigned char differs = 0;
  for (std::size_t i = 0; i < a.size(); ++i) differs = differs | static_cast<unsigned char>(a[i] ^ b[i]);
  return differs == 0;
}

std::optional<std::uint32_t> epoch_from_text(std::string_view text) {
  std::uint32_t epoch = 0;
  const char* const end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, epoch);
  // The end of line is the last byte written: without it the number may lack digits.
  return read.ec == std::errc() && end - read.ptr == 1 && *read.ptr == '\n' ? std::optional(epoch) : std::nullopt;
}

}  // namespace eigencast::broker
