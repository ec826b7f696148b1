// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "common/codec/chain.h"
#include "common/codec/pose_memory.h"

namespace eigencast {

/// The half spacing at which a sender remembers poses that it sends at `m`: no prediction is better than its memory.
constexpr std::uint8_t remembered_half_spacing(std::uint8_t m) {
  return static_cast<std::uint8_t>((m + 1) / 2);
}

/// A sender's side of a memory: finds the phase that predicts a key best. The search compares the key with a sketch of
/// 16 values of every pose, and with at most eight poses in full, so that its work is bounded; what it finds does not
/// bind receivers. Not thread-safe.
class Recaller {
 public:
  explicit Recaller(PoseMemory memory);

  const PoseMemory& memory() const { return memory_; }

  /// The cheaper, by estimate, of encode_key and encode_recalled_key. Errors: as encode_key.
  Result<CodedKey> encode(const ChainState& state, const Key& key, std::uint8_t half_spacing);

 private:
  static constexpr std::size_t kSketch = 16;
  struct Rated {
    double bits = 0;  ///< Estimated, up to a constant.
    std::uint32_t phase = 0;
  };
  struct Sought;

  void sketch_poses();
  /// The two poses that the key is most like, which are not neighbours.
  std::vector<std::uint32_t> alike(const Key& key);
  /// The phase about a pose at which the memory is nearest to the target.
  std::uint32_t phase_near(std::uint32_t pose, const Sought& sought, std::span<const std::int32_t> target) const;
  double bits_at(const Sought& sought, std::uint32_t phase);
  Rated best(const Sought& sought);

  PoseMemory memory_;
  std::vector<std::size_t> sketched_;  ///< Which values a sketch has.
  std::vector<float> sketches_;        ///< kSketch for each pose, in model units.
  std::vector<float> distances_;
  std::int64_t advance_ = PoseMemory::kParts;  ///< From the last phase but one to the last.
  std::vector<std::int32_t> c1_, c2_, e_, e1_, target_;
};

}  // namespace eigencast
