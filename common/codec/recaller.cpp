// SPDX-License-Identifier: MIT
#include "common/codec/recaller.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/codec/band.h"
#include "common/codec/fixed.h"

namespace eigencast {
namespace {

/// Sketches leave out the rows that move and turn the whole surface, which another place changes.
constexpr std::uint32_t kPlacingRows = 4;
/// Bits of a phase beyond those of the predictors that a plain frame has instead.
constexpr double kPhaseBits = 6, kFarPhaseBits = 8;

/// All values at a step; those out of range are wrong, which costs bits only.
std::span<const std::int32_t> at_step(const Key& key, std::uint8_t step, std::vector<std::int32_t>& values) {
  if (key.step == step) return key.q;
  const fixed::Rescale rule(key.step, step);
  values.resize(key.q.size());
  for (std::size_t i = 0; i < values.size(); ++i)
    values[i] =
        static_cast<std::int32_t>(std::clamp<std::int64_t>(rule(key.q[i]), -fixed::kMaxValue, fixed::kMaxValue));
  return values;
}

/// How far along the way from `from` to `to`, both in units of `scale`, the target is.
double along(std::span<const std::int32_t> target, std::span<const std::int32_t> from, std::span<const std::int32_t> to,
             double scale) {
  using Two = double __attribute__((vector_size(16)));
  const auto two = [](std::span<const std::int32_t> of, std::size_t i) {
    return Two{static_cast<double>(of[i]), static_cast<double>(of[i + 1])};
  };
  Two dot{}, square{};
  for (std::size_t i = 0; i + 1 < target.size(); i += 2) {
    const Two start = two(from, i), way = (two(to, i) - start) * scale;
    dot += (two(target, i) - start * scale) * way;
    square += way * way;
  }
  const double all = square[0] + square[1];
  return all > 0 ? (dot[0] + dot[1]) / all : 0;
}

}  // namespace

struct Recaller::Sought {
  const ChainState& state;
  const Key& key;
  BandMask bands;  ///< Those that are predicted.
  band::Spacing spacing;
  std::span<const std::int32_t> c1, c2, e1;
};

Recaller::Recaller(PoseMemory memory) : memory_(std::move(memory)) {
  const std::size_t size = memory_.layout().size();
  e_.resize(size), e1_.resize(size), target_.resize(size);
  if (!memory_.layout().is_float()) sketch_poses();
}

void Recaller::sketch_poses() {
  const CoefficientLayout& layout = memory_.layout();
  const std::size_t first = layout.rows > 2 * kPlacingRows ? kPlacingRows * layout.channels : 0;
  const std::uint32_t poses = memory_.pose_count();
  std::vector<double> sum(layout.size()), square(layout.size());
  for (std::uint32_t pose = 0; pose < poses; ++pose) {
    const double size = step_size(memory_.step_of(pose));
    const auto values = memory_.pose(pose);
    for (std::size_t i = first; i < values.size(); ++i) {
      const double value = values[i] * size;
      sum[i] += value, square[i] += value * value;
    }
  }
  const auto spread = [&](std::size_t i) { return square[i] - sum[i] * sum[i] / std::max(poses, 1u); };
  sketched_.resize(layout.size() - first);
  std::iota(sketched_.begin(), sketched_.end(), first);
  const std::size_t kept = std::min(kSketch, sketched_.size());
  std::partial_sort(sketched_.begin(), sketched_.begin() + static_cast<std::ptrdiff_t>(kept), sketched_.end(),
                    [&](std::size_t a, std::size_t b) { return spread(a) > spread(b); });
  sketched_.resize(kept);
  sketches_.assign(std::size_t{poses} * kSketch, 0);
  for (std::uint32_t pose = 0; pose < poses; ++pose) {
    const double size = step_size(memory_.step_of(pose));
    for (std::size_t i = 0; i < kept; ++i)
      sketches_[pose * kSketch + i] = static_cast<float>(memory_.pose(pose)[sketched_[i]] * size);
  }
  distances_.resize(poses);
}

std::vector<std::uint32_t> Recaller::alike(const Key& key) {
  using Four = float __attribute__((vector_size(16)));
  std::array<Four, kSketch / 4> target{};
  const double size = step_size(key.step);
  for (std::size_t i = 0; i < sketched_.size(); ++i)
    target[i / 4][i % 4] = static_cast<float>(key.q[sketched_[i]] * size);
  for (std::size_t pose = 0; pose < distances_.size(); ++pose) {
    Four sum{};
    const float* sketch = sketches_.data() + pose * kSketch;
    for (std::size_t i = 0; i < target.size(); ++i, sketch += 4) {
      const Four far = target[i] - Four{sketch[0], sketch[1], sketch[2], sketch[3]};
      sum += far * far;
    }
    distances_[pose] = sum[0] + sum[1] + sum[2] + sum[3];
  }
  const auto nearest = [&](std::ptrdiff_t first, std::ptrdiff_t last) {
    return std::min_element(distances_.begin() + first, distances_.begin() + last) - distances_.begin();
  };
  const auto count = std::ssize(distances_);
  const auto best = nearest(0, count), low = std::max<std::ptrdiff_t>(best - 1, 0), high = std::min(best + 2, count);
  std::vector<std::uint32_t> out{static_cast<std::uint32_t>(best)};
  auto other = low > 0 ? nearest(0, low) : count;
  if (high < count) {
    const auto after = nearest(high, count);
    if (other == count || distances_[static_cast<std::size_t>(after)] < distances_[static_cast<std::size_t>(other)])
      other = after;
  }
  if (other < count) out.push_back(static_cast<std::uint32_t>(other));
  return out;
}

std::uint32_t Recaller::phase_near(std::uint32_t pose, const Sought& sought,
                                   std::span<const std::int32_t> target) const {
  constexpr std::uint32_t kParts = PoseMemory::kParts;
  const std::uint32_t phase = pose * kParts;
  const double scale = step_size(memory_.step_of(pose)) / step_size(sought.key.step);
  const auto parts = [](double way) {
    return static_cast<std::uint32_t>(std::lround(std::clamp(way, 0.0, 1.0) * kParts));
  };
  double ahead = 0;
  if (memory_.has(phase + 1)) ahead = along(target, memory_.pose(pose), memory_.pose(pose + 1), scale);
  if (ahead > 0 || pose == 0 || !memory_.has(phase - 1)) return phase + parts(ahead);
  return phase - parts(along(target, memory_.pose(pose), memory_.pose(pose - 1), scale));
}

double Recaller::bits_at(const Sought& sought, std::uint32_t phase) {
  const CoefficientLayout& layout = memory_.layout();
  double bits = kPhaseBits;
  const std::int64_t far = std::int64_t{phase} - sought.state.phase.value_or(0);
  if (far < -64 || far > 63) bits += kFarPhaseBits;
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!sought.bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    const auto part = [first = first, count = last - first](std::span<const std::int32_t> of) {
      return of.empty() ? of : of.subspan(first, count);
    };
    if (!memory_.recall(phase, sought.key.step, first, std::span(e_).subspan(first, last - first))) return HUGE_VAL;
    bits += band::estimated_bits(part(sought.key.q), {part(sought.c1), part(sought.c2), part(e_), part(sought.e1)},
                                 sought.spacing);
  }
  return bits;
}

Recaller::Rated Recaller::best(const Sought& sought) {
  constexpr std::int64_t kParts = PoseMemory::kParts;
  std::vector<Rated> rated;
  const auto rate = [&](std::int64_t phase) {
    if (phase < 0 || !memory_.has(static_cast<std::uint64_t>(phase))) return;
    const auto at = static_cast<std::uint32_t>(phase);
    if (std::none_of(rated.begin(), rated.end(), [&](const Rated& r) { return r.phase == at; }))
      rated.push_back({bits_at(sought, at), at});
  };
  if (sought.state.phase) {
    const std::int64_t next = (std::int64_t{*sought.state.phase} + advance_ + kParts / 2) / kParts;
    const auto pose = static_cast<std::uint32_t>(std::clamp<std::int64_t>(next, 0, memory_.pose_count() - 1));
    rate(phase_near(pose, sought, sought.key.q));
    for (std::size_t i = 0; i < sought.e1.size(); ++i)
      target_[i] = static_cast<std::int32_t>(std::int64_t{sought.key.q[i]} - sought.c1[i] + sought.e1[i]);
    if (!sought.e1.empty()) rate(phase_near(pose, sought, target_));
  }
  for (const std::uint32_t pose : alike(sought.key)) rate(phase_near(pose, sought, sought.key.q));
  const auto cheaper = [](const Rated& a, const Rated& b) { return a.bits < b.bits; };
  const std::int64_t best = std::min_element(rated.begin(), rated.end(), cheaper)->phase;
  rate(best - 1), rate(best + 1);
  return *std::min_element(rated.begin(), rated.end(), cheaper);
}

Result<CodedKey> Recaller::encode(const ChainState& state, const Key& key, std::uint8_t half_spacing) {
  const CoefficientLayout& layout = memory_.layout();
  const auto plain = [&] { return encode_key(layout, state, key, half_spacing); };
  const bool fits = key.q.size() == layout.size() && state.newer.q.size() == layout.size() &&
                    state.older.q.size() == layout.size() && half_spacing <= band::kMaxHalfSpacing;
  const BandMask bands = key.bands & state.newer.bands & state.older.bands & layout.all_bands();
  if (memory_.pose_count() == 0 || half_spacing == 0 || bands.empty() || !fits) return plain();
  if (state.phase && !memory_.has(*state.phase)) return plain();
  Sought sought{state,
                key,
                bands,
                {half_spacing, layout.channels},
                at_step(state.newer, key.step, c1_),
                at_step(state.older, key.step, c2_),
                {}};
  double plain_bits = 0;
  for (std::size_t band = 0; band < layout.band_ends.size(); ++band) {
    if (!bands.has(band)) continue;
    const auto [first, last] = layout.range(band);
    const std::size_t count = last - first;
    plain_bits +=
        band::estimated_bits(std::span(key.q).subspan(first, count),
                             {sought.c1.subspan(first, count), sought.c2.subspan(first, count)}, sought.spacing);
  }
  if (state.phase && memory_.recall(*state.phase, key.step, 0, e1_)) sought.e1 = e1_;
  const Rated found = best(sought);
  if (found.bits >= plain_bits) return plain();
  auto coded = encode_recalled_key(layout, state, memory_, found.phase, key, half_spacing);
  if (!coded) return plain();
  if (state.phase) advance_ = std::clamp<std::int64_t>(std::int64_t{found.phase} - *state.phase, -64, 64);
  return coded;
}

}  // namespace eigencast
