// SPDX-License-Identifier: MIT
#include "sdk/key_writer.h"

#include <algorithm>
#include <utility>

namespace eigencast {
namespace {

/// The key at the step of coded levels, which moves its values by no more than coding does.
Key at_levels(const CoefficientLayout& layout, const Key& key, std::uint8_t half_spacing) {
  if (layout.is_float() || half_spacing == 0) return key;
  const std::uint8_t step = step_index_below(2.0 * half_spacing * step_size(key.step));
  auto coarse = key_from_coefficients(layout, coefficients_from_key(layout, key), step);
  if (!coarse) return key;
  coarse->bands = key.bands;
  return *std::move(coarse);
}

}  // namespace

KeyWriter::KeyWriter(CoefficientLayout layout, std::uint8_t half_spacing, std::optional<RateControl> rate,
                     std::uint8_t coarse_half_spacing)
    : layout_(std::move(layout)),
      half_spacing_(half_spacing),
      coarse_half_spacing_(std::max(half_spacing, coarse_half_spacing)),
      rate_(std::move(rate)) {}

void KeyWriter::code_by(Coder coder, std::optional<PoseMemory> memory, bool continues) {
  coder_ = std::move(coder);
  memory_ = std::move(memory);
  if (chain_ && !continues) chain_->phase.reset();
}

void KeyWriter::begin(const control::Announced& announced) {
  restart();
  announced_ = announced;
  newest_ = {};
}

void KeyWriter::continue_as(const control::Announced& announced, const ChainClock& newest, std::optional<Key> older) {
  begin(announced);
  newest_ = newest;
  older_ = std::move(older);
}

Result<KeyWriter::Coded> KeyWriter::code(Key key, TimeUs capture_us) const {
  const std::size_t all = layout_.band_ends.size();
  const auto choice = rate_ ? rate_->choice() : RateControl::Choice{half_spacing(), static_cast<std::uint8_t>(all)};
  if (choice.bands < all) key = lowest_bands(layout_, std::move(key), choice.bands);
  if (chain_) {
    auto coded =
        coder_ ? coder_(*chain_, key, choice.half_spacing) : encode_key(layout_, *chain_, key, choice.half_spacing);
    if (!coded) return coded.error();
    return framed(*std::move(coded), capture_us);
  }
  // A key is predicted from the two before it; the first one goes out as the state that holds it twice.
  ChainState first = advanced(std::nullopt, std::move(key), 0);
  if (older_) {
    // All viewers get these two at once: exactly they would take as much as a dozen keys.
    first.newer = at_levels(layout_, first.newer, choice.half_spacing);
    first.older = at_levels(layout_, *older_, choice.half_spacing);
    if (choice.bands < all) first.older = lowest_bands(layout_, std::move(first.older), choice.bands);
    first.age_us = capture_us - newest_.capture_us;
  }
  const auto payload = encode_join(layout_, first);
  if (!payload) return payload.error();
  return framed(FrameKind::kJoin, *payload, std::move(first), capture_us);
}

Result<KeyWriter::Coded> KeyWriter::code_as(Key key, ByteView payload, std::optional<std::uint32_t> phase,
                                            TimeUs capture_us) const {
  if (!chain_ || payload.empty()) return code(std::move(key), capture_us);
  CodedKey as_it_was{Bytes(payload.begin(), payload.end()), key, phase};
  if (!phase) {
    if (const auto here = decode_key(layout_, key.bands, *chain_, payload); here && *here == key)
      return framed(std::move(as_it_was), capture_us);
    return code(std::move(key), capture_us);
  }
  if (!memory_ || !memory_->has(*phase)) return code(std::move(key), capture_us);
  const auto here = decode_recalled_key(layout_, key.bands, *chain_, *memory_, payload);
  if (here && here->key == key && here->phase == *phase) return framed(std::move(as_it_was), capture_us);
  // The chain lacks the phase before: a join has this one, and the keys after it follow as they did.
  ChainState next{chain_->newer, std::move(key), capture_us - newest_.capture_us, phase};
  const auto join = encode_join(layout_, next);
  if (!join) return join.error();
  return framed(FrameKind::kJoin, *join, std::move(next), capture_us);
}

KeyWriter::Coded KeyWriter::framed(CodedKey coded, TimeUs capture_us) const {
  const ByteView payload = coded.payload;
  return framed(FrameKind::kKey, payload,
                {chain_->newer, std::move(coded.key), capture_us - newest_.capture_us, coded.phase}, capture_us);
}

KeyWriter::Coded KeyWriter::framed(FrameKind kind, ByteView payload, ChainState next, TimeUs capture_us) const {
  Envelope envelope;
  envelope.bands = next.newer.bands;
  envelope.stream_id = announced_.stream_id;
  envelope.tag = announced_.tag;
  envelope.sequence = newest_.sequence + 1;
  envelope.capture_us = capture_us;
  envelope.kind = kind;
  envelope.flags = next.phase ? Envelope::kRecalled : std::uint8_t{0};
  if (kind == FrameKind::kJoin) envelope.age_us = next.age_us;
  Coded out{{}, std::move(next), capture_us};
  out.message.reserve(Envelope::kMaxBytes + payload.size());
  append_envelope(envelope, &newest_, out.message);
  out.message.insert(out.message.end(), payload.begin(), payload.end());
  return out;
}

void KeyWriter::sent(Coded coded, std::size_t bytes) {
  chain_ = std::move(coded.next);
  older_.reset();
  newest_ = {newest_.sequence + 1, coded.capture_us, chain_->age_us};
  if (rate_) rate_->add(bytes, coded.capture_us);
}

std::vector<double> KeyWriter::positions_held() const {
  if (!chain_) return {};
  std::vector<double> C = coefficients_from_key(layout_, chain_->newer);
  if (layout_.channels == 3) return C;
  for (std::size_t row = 0; row < layout_.rows; ++row)
    std::copy_n(C.begin() + static_cast<std::ptrdiff_t>(row * layout_.channels), 3,
                C.begin() + static_cast<std::ptrdiff_t>(row * 3));
  C.resize(std::size_t{layout_.rows} * 3);
  return C;
}

}  // namespace eigencast
