// SPDX-License-Identifier: MIT
#include "sdk/frame_decoder.h"

#include <algorithm>

namespace eigencast {

void FrameDecoder::set_stream(const control::StreamInfo& info) {
  const auto codec = codec_from_name(info.format.codec);
  const bool usable = info.state != control::StreamInfo::State::kWaiting && codec;
  if (!usable) {
    has_stream_ = false;
    chain_.reset();
    return;
  }
  const CoefficientLayout layout{*codec, info.format.rows, info.format.channels, info.format.band_ends};
  if (!has_stream_ || info.stream_id != stream_id_ || info.epoch != epoch_ || layout != layout_) {
    chain_.reset();
    last_seen_.reset();
    memory_.reset();
  }
  has_stream_ = true;
  stream_id_ = info.stream_id;
  epoch_ = info.epoch;
  layout_ = layout;
  scales_.clear();
  for (const ScalarChannel& scalar : info.format.scalars) scales_.push_back(scalar.scale);
  velocities_ = {info.format.velocity_channels, info.format.velocity_us};
  scheme_ = info.profile.scheme;
}

Result<void> FrameDecoder::remember(std::shared_ptr<const MemorySegment> segment) {
  if (!memory_) memory_.emplace(layout_);
  return memory_->add(std::move(segment));
}

std::vector<double> FrameDecoder::coefficients(const Key& key) const {
  std::vector<double> C = coefficients_from_key(layout_, key);
  for (std::size_t row = 0; row < layout_.rows; ++row)
    for (std::size_t k = 0; k < scales_.size(); ++k) C[row * layout_.channels + 3 + k] /= scales_[k];
  return C;
}

Result<CodedKey> FrameDecoder::read_key(const FrameView& frame) const {
  const BandMask bands = frame.envelope.bands;
  if (!frame.envelope.is_recalled()) {
    auto key = decode_key(layout_, bands, *chain_, frame.payload);
    return key ? Result<CodedKey>({{}, *std::move(key)}) : key.error();
  }
  if (!memory_) return fail(ErrorCode::kCorrupt, "a key predicted from a memory that is not here");
  auto recalled = decode_recalled_key(layout_, bands, *chain_, *memory_, frame.payload);
  return recalled ? Result<CodedKey>({{}, std::move(recalled->key), recalled->phase}) : recalled.error();
}

Result<Key> FrameDecoder::made_pose(const FrameView& frame) const {
  const ChainState& state = *chain_;
  const Envelope& e = frame.envelope;
  if (e.kind == FrameKind::kEstimate)
    return estimate_keys(layout_, state.older, state.newer, scheme_ == Profile::Scheme::kDamped, e.step.at, e.step.of);
  auto pose = scheme_ == Profile::Scheme::kHermite
                  ? hermite_keys(layout_, velocities_, state.older, state.newer, state.age_us, e.step.at, e.step.of)
                  : interpolate_keys(layout_, state.older, state.newer, e.step.at, e.step.of);
  if (!pose || e.is_key() || e.bands.empty()) return pose;
  return decode_residual(layout_, e.bands, *std::move(pose), frame.payload);
}

Result<const Key*> FrameDecoder::shown(Result<Key> made) {
  if (!made) return made.error();
  ++counts_.synthetic;
  made_ = *std::move(made);
  return &made_;
}

Result<const Key*> FrameDecoder::decode(const FrameView& frame) {
  const Envelope& e = frame.envelope;
  if (!has_stream_ || e.stream_id != stream_id_ || e.epoch != epoch_) {
    ++counts_.rejected;
    return nullptr;
  }
  auto pose = apply(frame);
  if (!pose) ++counts_.rejected;
  return pose;
}

Result<const Key*> FrameDecoder::apply(const FrameView& frame) {
  const Envelope& e = frame.envelope;
  const auto undecodable = [&]() -> const Key* {
    ++counts_.rejected;
    return nullptr;
  };
  switch (e.kind) {
    case FrameKind::kJoin: {
      auto state = decode_join(layout_, e.bands, frame.payload, e.is_recalled());
      if (!state) return state.error();
      if (state->phase && !(memory_ && memory_->has(*state->phase)))
        return fail(ErrorCode::kCorrupt, "a join of a memory that is not here");
      const bool is_same = chain_ && e.sequence == newest_ && e.capture_us == newest_capture_us_ &&
                           state->newer == chain_->newer && !e.is_ahead();
      chain_ = std::move(*state);
      chain_->age_us = e.age_us;
      ++counts_.joins;
      if (is_same && newest_shown_) return nullptr;
      break;
    }
    case FrameKind::kKey: {
      if (!chain_ || e.sequence != newest_ + 1) {
        if (chain_ && e.sequence > newest_) chain_.reset();
        return undecodable();
      }
      auto key = read_key(frame);
      if (!key) {
        chain_.reset();
        return key.error();
      }
      chain_ = advanced(std::move(chain_), std::move(key->key), e.capture_us - newest_capture_us_, key->phase);
      break;
    }
    case FrameKind::kStep:
    case FrameKind::kEstimate:
      if (!chain_ || e.sequence != newest_) return undecodable();
      newest_shown_ = newest_shown_ || (e.kind == FrameKind::kStep && e.step.at == e.step.of);
      return shown(made_pose(frame));
  }
  if (!last_seen_ || e.sequence > *last_seen_) ++counts_.keys;
  if (last_seen_ && e.sequence > *last_seen_ + 1) counts_.missed += e.sequence - *last_seen_ - 1;
  last_seen_ = std::max(last_seen_.value_or(e.sequence), e.sequence);
  newest_ = e.sequence;
  newest_capture_us_ = e.capture_us;
  ahead_ = e.is_ahead();
  newest_shown_ = !ahead_;
  if (e.step.of != 0) return shown(made_pose(frame));
  return ahead_ ? nullptr : &chain_->newer;
}

}  // namespace eigencast
