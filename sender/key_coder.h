// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "common/asset/asset.h"
#include "common/codec/chain.h"
#include "common/codec/pose_memory.h"
#include "common/codec/recaller.h"
#include "sdk/rank_trial.h"
#include "sender/evaluate.h"

namespace eigencast {

/// What `act` gives; how long that took goes to `ns`.
template <typename Act>
auto timed(Histogram& ns, Act&& act) {
  const auto start = std::chrono::steady_clock::now();
  auto result = act();
  ns.add(std::chrono::nanoseconds(std::chrono::steady_clock::now() - start).count());
  return result;
}

/// Codes and decodes keys one after the other.
class KeyCoder {
  static constexpr TimeUs kKeyInterval = 33'333;

 public:
  KeyCoder(const Asset& asset, const CoefficientLayout& layout, const Quantiser& quantiser,
           std::optional<ChainState> state = {}, const PoseMemory* memory = nullptr)
      : asset_(asset), layout_(layout), quantiser_(quantiser), state_(std::move(state)) {
    if (memory != nullptr) recaller_.emplace(*memory);
  }

  /// The newer key of the state is then what was decoded.
  Result<void> code(std::span<const double> C) {
    const auto key = key_from_coefficients(layout_, C, quantiser_.step);
    if (!key) return key.error();
    if (auto coded = code(*key); !coded) return coded;
    squares_ += std::pow(surface_distance(C, received(), asset_.area), 2);
    keys_.quantising_rms = std::sqrt(squares_ / static_cast<double>(++measured_));
    return {};
  }
  Result<void> code(const Key& key) {
    if (!state_) {
      state_ = advanced(std::nullopt, key, 0);
      return {};
    }
    auto coded = timed(keys_.encode_ns, [&] {
      return recaller_ ? recaller_->encode(*state_, key, quantiser_.half_spacing)
                       : encode_key(layout_, *state_, key, quantiser_.half_spacing);
    });
    if (!coded) return coded.error();
    const auto decoded = timed(keys_.decode_ns, [&]() -> Result<Key> {
      if (!coded->phase) return decode_key(layout_, layout_.all_bands(), *state_, coded->payload);
      auto recalled = decode_recalled_key(layout_, layout_.all_bands(), *state_, recaller_->memory(), coded->payload);
      if (!recalled) return recalled.error();
      return std::move(recalled->key);
    });
    if (!decoded) return decoded.error();
    if (*decoded != coded->key) return fail(ErrorCode::kInternal, "a decoded key differs from the one that was coded");
    state_ = advanced(std::move(state_), coded->key, kKeyInterval, coded->phase);
    ++keys_.frames;
    keys_.recalled += coded->phase ? 1 : 0;
    keys_.payload_bytes += coded->payload.size();
    keys_.wire_bytes += key_message_bytes(coded->payload.size());
    last_ = std::move(*coded);
    return {};
  }
  /// REQUIRES: `memory` begins as the one before, or the state forgets where it was.
  void remember(const PoseMemory& memory) { recaller_.emplace(memory); }
  void forget() { recaller_.reset(), state_->phase.reset(); }
  const CodedKey& last() const { return last_; }  ///< Of the last key but a join.
  const std::optional<ChainState>& state() const { return state_; }
  std::vector<double> received() const { return coefficients_from_key(layout_, state_->newer); }
  const CodedKeys& keys() const { return keys_; }

 private:
  const Asset& asset_;
  const CoefficientLayout& layout_;
  Quantiser quantiser_;
  std::optional<ChainState> state_;
  std::optional<Recaller> recaller_;
  CodedKeys keys_;
  CodedKey last_;
  double squares_ = 0;
  std::uint64_t measured_ = 0;
};

}  // namespace eigencast
