// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/codec/range_coder.h"
#include "common/core/bytes.h"

/// Numbers of a distribution that is not known before as a run of bytes: decisions of a range coder whose probabilities
/// are learned on the way (docs/asset-format.md, "Coded"). What writes and what reads is one function, `pass`: a
/// writer takes the value and gives it back, a reader takes anything and gives what was written.
namespace eigencast {

/// A decision and how probable it has been: the mean of a quick and a slow estimate, never 0 or 1.
class AdaptiveBit {
 public:
  /// Returns that of `true`, in units of 2^-15.
  std::uint32_t probability() const { return (std::uint32_t{quick_} + slow_) >> 2; }
  void learn(bool decision) {
    if (seen_ < kSlow) ++seen_;
    const unsigned quick = std::min<unsigned>(seen_, kQuick);
    if (decision) {
      quick_ = static_cast<std::uint16_t>(quick_ + ((kOne - quick_) >> quick));
      slow_ = static_cast<std::uint16_t>(slow_ + ((kOne - slow_) >> seen_));
    } else {
      quick_ = static_cast<std::uint16_t>(quick_ - (quick_ >> quick));
      slow_ = static_cast<std::uint16_t>(slow_ - (slow_ >> seen_));
    }
  }

 private:
  static constexpr unsigned kOne = 0xffff, kQuick = 4, kSlow = 7;
  std::uint16_t quick_ = 0x8000, slow_ = 0x8000, seen_ = 0;
};

class BitWriter {
 public:
  explicit BitWriter(Bytes& out) : encoder_(out) {}
  bool pass(bool decision, AdaptiveBit& bit) {
    encoder_.put(decision, bit.probability());
    bit.learn(decision);
    return decision;
  }
  bool pass_even(bool decision) {
    encoder_.put_even(decision);
    return decision;
  }
  void finish() { encoder_.finish(); }

 private:
  band::RangeEncoder encoder_;
};

class BitReader {
 public:
  explicit BitReader(ByteView in) : decoder_(in) {}
  bool pass(bool, AdaptiveBit& bit) {
    const bool decision = decoder_.get(bit.probability());
    bit.learn(decision);
    return decision;
  }
  bool pass_even(bool) { return decoder_.get_even(); }
  bool finished() const { return decoder_.finished(); }

 private:
  band::RangeDecoder decoder_;
};

/// Numbers of up to 32 bits: how many bits one has, as decisions "more than 0", "more than 1", ...; then its bits below
/// the highest, of which the first three know those before them, and the others are even.
class NumberModel {
 public:
  template <typename Coder>
  std::uint32_t pass(Coder& coder, std::uint32_t value) {
    unsigned bits = 0;
    while (bits < kMaxBits && coder.pass((std::uint64_t{value} >> bits) != 0, more_[bits])) ++bits;
    if (bits == 0) return 0;
    std::uint32_t number = 1;
    for (unsigned position = bits - 1; position-- > 0;) {
      const bool bit = (value >> position & 1) != 0;
      const bool coded = number < kTree ? coder.pass(bit, tree_[bits - 1][number]) : coder.pass_even(bit);
      number = number << 1 | std::uint32_t{coded};
    }
    return number;
  }

 private:
  static constexpr unsigned kMaxBits = 32;
  static constexpr std::uint32_t kTree = 8;
  std::array<AdaptiveBit, kMaxBits> more_;
  std::array<std::array<AdaptiveBit, kTree>, kMaxBits> tree_;
};

/// The same with a sign.
class SignedModel {
 public:
  template <typename Coder>
  std::uint32_t pass_size(Coder& coder, std::uint32_t size) {
    return size_.pass(coder, size);
  }
  template <typename Coder>
  std::int32_t pass(Coder& coder, std::int32_t value) {
    const std::uint32_t size = size_.pass(coder, size_of(value));
    if (size == 0) return 0;
    return static_cast<std::int32_t>(coder.pass(value < 0, negative_) ? 0 - size : size);
  }
  static std::uint32_t size_of(std::int32_t value) {
    return value < 0 ? 0 - static_cast<std::uint32_t>(value) : static_cast<std::uint32_t>(value);
  }

 private:
  NumberModel size_;
  AdaptiveBit negative_;
};

/// What prediction leaves of columns of integers. Rows that are hard to predict are so in every column: the size of a
/// residual is predicted by those that the row has had, times what this column's have been beside that.
class ResidualModel {
 public:
  explicit ResidualModel(std::size_t rows) : of_row_(rows, 2 * kOne) {}

  void next_column() {
    ++columns_;
    met_ = expected_ = kPrior;
  }
  template <typename Coder>
  std::int32_t pass(Coder& coder, std::size_t i, std::int32_t residual) {
    std::int32_t& mean = of_row_[i];
    const std::uint64_t likely = static_cast<std::uint64_t>(mean) * met_ / expected_;
    residual = contexts_[context_of(likely)].pass(coder, residual);
    const auto size = static_cast<std::int32_t>(kOne * std::min(SignedModel::size_of(residual), kMaxCounted));
    met_ += static_cast<std::uint32_t>(size);
    expected_ += static_cast<std::uint32_t>(mean);
    if (expected_ >= kWindow) {
      met_ = (met_ + 1) / 2;
      expected_ = (expected_ + 1) / 2;
    }
    mean = std::max(mean + (size - mean) / std::min(columns_ + 1, kColumnsKept), 1);
    return residual;
  }

 private:
  static constexpr std::int32_t kOne = 16;
  static constexpr std::uint32_t kMaxCounted = 4095;
  static constexpr std::int32_t kColumnsKept = 10;
  static constexpr std::uint32_t kPrior = 1 << 10, kWindow = 1 << 16;

  /// Two to a doubling.
  std::size_t context_of(std::uint64_t likely) const {
    const auto bits = static_cast<std::size_t>(std::bit_width(likely));
    if (bits < 2) return bits;
    return std::min<std::size_t>(2 * bits - 2 + (likely >> (bits - 2) & 1), contexts_.size() - 1);
  }

  std::vector<std::int32_t> of_row_;  // mean size of its residuals, the last ones most
  std::array<SignedModel, 40> contexts_;
  std::int32_t columns_ = 0;
  std::uint32_t met_ = kPrior, expected_ = kPrior;  // in this column: sizes, and what the rows' means are
};

/// A tile of numbers of some kinds, each with probabilities of its own.
template <typename Coder>
class NumberRun {
 public:
  /// run: what a BitWriter or a BitReader is made of.
  template <typename Run>
  NumberRun(Run&& run, std::size_t kinds) : coder_(std::forward<Run>(run)), kinds_(kinds) {}

  std::uint32_t pass(std::size_t kind, std::uint32_t value = 0) { return kinds_[kind].pass_size(coder_, value); }
  std::int32_t pass_signed(std::size_t kind, std::int32_t value = 0) { return kinds_[kind].pass(coder_, value); }
  Coder& coder() { return coder_; }

 private:
  Coder coder_;
  std::vector<SignedModel> kinds_;
};
using NumberWriter = NumberRun<BitWriter>;
using NumberReader = NumberRun<BitReader>;

}  // namespace eigencast
