// SPDX-License-Identifier: MIT
#include "sender/evaluate.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "common/codec/memory_keeper.h"
#include "common/codec/pose_memory.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/checks/jumps.h"
#include "common/surface/vector.h"
#include "sdk/rank_trial.h"
#include "sender/clip_coefficients.h"
#include "sender/evaluate_learning.h"
#include "sender/key_coder.h"
#include "sender/order_check.h"
#include "sender/performance.h"

namespace eigencast {
namespace {

constexpr std::size_t kStillPoses = 60;  // two seconds
constexpr double kCoarsest = 8;
constexpr int kBisections = 8;
constexpr double kUploadS = 0.2;  ///< From the decision to remember poses to their first use.

Result<StillPose> still_pose(KeyCoder coder, const Key& key, const Asset& asset) {
  StillPose still;
  std::vector<double> before = coder.received();
  for (std::size_t pose = 1; pose <= kStillPoses; ++pose) {
    if (const auto coded = coder.code(key); !coded) return coded.error();
    std::vector<double> now = coder.received();
    const double moved = surface_distance(before, now, asset.area) / asset.diagonal();
    if (moved > 0) still.settles_after = pose;
    if (2 * pose > kStillPoses) still.moves = std::max(still.moves, moved);
    before = std::move(now);
  }
  return still;
}

/// All passes after the first, from the state after it. `first_use`: of the memory, in frames; may be null.
Result<CodedKeys> code_passes(KeyCoder coder, Performance performance, unsigned passes, std::uint64_t* first_use,
                              const BakeProgress& progress) {
  for (unsigned pass = 1; pass < passes; ++pass, performance.restart()) {
    if (progress && !progress(1, "coding it again")) return fail(ErrorCode::kCancelled, "stopped while evaluating");
    for (;;) {
      const auto pose = performance.next();
      if (!pose) return pose.error();
      if (!*pose) break;
      if (const auto coded = coder.code((*pose)->C); !coded) return coded.error();
      if (first_use != nullptr && coder.keys().recalled == 0) ++*first_use;
    }
  }
  return coder.keys();
}

Result<AgainEvaluation> evaluate_again(const AgainOptions& options, const CoefficientStore& clip, std::size_t frames,
                                       const Asset& asset, const CoefficientLayout& layout, double eps,
                                       const std::optional<ChainState>& state, const BakeProgress& progress) {
  const Quantiser quantiser = quantiser_for_error(eps, asset.area, asset.rank);
  AgainEvaluation result{options, {}, {}, {}, eps, 0, 0, frames};
  std::vector<Key> remembered;
  while (remembered.size() < frames && PoseMemory::check_size(layout, remembered.size() + 1)) {
    const auto C = clip.at(remembered.size());
    if (!C) return C.error();
    auto key = key_from_coefficients(layout, *C, quantiser.step);
    if (!key) return key.error();
    remembered.push_back(std::move(*key));
  }
  const auto segment = encode_segment(layout, {}, remembered, remembered_half_spacing(quantiser.half_spacing));
  if (!segment) return segment.error();
  const auto memory = PoseMemory(layout).with(segment->segment);
  if (!memory) return memory.error();
  result.poses = memory->pose_count();
  result.memory_bytes = segment->bytes.size();
  const Performance performance(clip, frames, asset, options);
  const auto coded = [&](double eps_of, const PoseMemory* with, std::uint64_t* first_use) {
    return code_passes({asset, layout, quantiser_for_error(eps_of, asset.area, asset.rank), state, with}, performance,
                       options.passes, first_use, progress);
  };
  auto plain = coded(eps, nullptr, nullptr), recalled = coded(eps, &*memory, &result.first_use);
  if (!plain || !recalled) return plain ? recalled.error() : plain.error();
  // What a memory predicts well has less error than asked for: coarser keys are as good.
  double fine = eps / 2, coarse = kCoarsest * eps;
  result.equal = *plain;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = std::sqrt(fine * coarse);
    auto tried = coded(middle, &*memory, nullptr);
    if (!tried) return tried.error();
    if (tried->quantising_rms > plain->quantising_rms) {
      coarse = middle;
    } else {
      fine = middle;
      if (tried->wire_bytes < result.equal.wire_bytes) result.equal = std::move(*tried), result.equal_eps = middle;
    }
  }
  result.plain = std::move(*plain), result.recalled = std::move(*recalled);
  return result;
}

/// Both streams, and what the one with a memory takes beside its keys.
class Loop {
 public:
  Loop(const LoopOptions& options, const Asset& asset, const CoefficientLayout& layout, const Quantiser& quantiser)
      : asset_(asset),
        layout_(layout),
        quantiser_(quantiser),
        plain_(asset, layout, quantiser),
        live_(asset, layout, quantiser),
        keeper_({layout}),
        rebuilder_(asset),
        error_(asset.diagonal()) {
    result_.options = options;
  }

  Result<void> add(std::span<const double> C, std::span<const Vec3> truth) {
    const double now = static_cast<double>(frame_++) / result_.options.rate_hz;
    const auto key = key_from_coefficients(layout_, C, quantiser_.step);
    if (!key) return key.error();
    if (ready_s_ && now >= *ready_s_) {
      if (auto held = hold(); !held) return held;
    }
    const auto before = live_.state();
    const std::uint64_t plain_before = plain_.keys().wire_bytes, before_bytes = bytes();
    if (auto coded = plain_.code(C); !coded) return coded;
    if (auto coded = live_.code(C); !coded) return coded;
    error_.add(rows_of(asset_, truth), rebuilder_.rebuild_rows(live_.received(), 3));
    if (before) {
      const MemoryKeeper::Sent sent{*before,
                                    *key,
                                    live_.last().payload.size(),
                                    live_.last().phase,
                                    quantiser_.half_spacing,
                                    std::llround(now * 1e6),
                                    !ready_s_};
      if (timed(result_.keep_ns, [&] { return keeper_.add(sent); })) {
        result_.memory_bytes += keeper_.segments().back().bytes.size() + MemoryKeeper::kSegmentBytes;
        ready_s_ = now + kUploadS;
      }
    }
    if (live_.keys().recalled > 0 && !result_.first_use_s) result_.first_use_s = now;
    if (bytes() > plain_.keys().wire_bytes)
      result_.paid_back_s.reset();
    else if (result_.memory_bytes > 0 && !result_.paid_back_s)
      result_.paid_back_s = now;
    const auto second = static_cast<std::size_t>(now);
    result_.kbit_per_s.resize(second + 1), result_.plain_kbit_per_s.resize(second + 1);
    result_.kbit_per_s[second] += static_cast<double>(bytes() - before_bytes) * 8e-3;
    result_.plain_kbit_per_s[second] += static_cast<double>(plain_.keys().wire_bytes - plain_before) * 8e-3;
    return {};
  }
  LoopEvaluation result() && {
    result_.plain = plain_.keys(), result_.live = live_.keys(), result_.error = error_.result();
    return std::move(result_);
  }

 private:
  std::uint64_t bytes() const { return live_.keys().wire_bytes + result_.memory_bytes; }
  /// Receivers hold the memory now.
  Result<void> hold() {
    PoseMemory memory(layout_);
    for (const CodedSegment& segment : keeper_.segments()) {
      auto more = memory.with(segment.segment);
      if (!more) return more.error();
      memory = std::move(*more);
    }
    if (keeper_.segments().size() <= held_) {
      const auto join = encode_join(layout_, *live_.state());
      if (!join) return join.error();
      live_.forget();
      result_.memory_bytes += key_message_bytes(join->size());
      ++result_.roots;
    }
    held_ = keeper_.segments().size();
    result_.poses = memory.pose_count();
    live_.remember(memory);
    ready_s_.reset();
    return {};
  }

  LoopEvaluation result_;
  const Asset& asset_;
  const CoefficientLayout& layout_;
  Quantiser quantiser_;
  KeyCoder plain_, live_;
  MemoryKeeper keeper_;
  SourceRebuilder rebuilder_;
  SurfaceErrorSum error_;
  std::uint64_t frame_ = 0;
  std::size_t held_ = 0;           ///< Segments that receivers hold.
  std::optional<double> ready_s_;  ///< When they hold the keeper's.
};

Result<LoopEvaluation> evaluate_loop(const LoopOptions& options, const MotionClip& clip, const CoefficientStore& store,
                                     const Asset& asset, const CoefficientLayout& layout, double eps,
                                     const BakeProgress& progress) {
  Loop loop(options, asset, layout, quantiser_for_error(eps, asset.area, asset.rank));
  const auto frames = static_cast<std::uint64_t>(std::ceil(options.seconds * options.rate_hz));
  for (std::uint64_t frame = 0; frame < frames; ++frame) {
    const double done = static_cast<double>(frame) / static_cast<double>(frames);
    if (progress && !progress(done, "playing a loop")) return fail(ErrorCode::kCancelled, "stopped while evaluating");
    const std::size_t at = frame % clip.frame_count();
    const auto C = store.at(at);
    if (!C) return C.error();
    const auto truth = clip.pose(at);
    if (!truth) return truth.error();
    if (auto added = loop.add(*C, *truth); !added) return added.error();
  }
  return std::move(loop).result();
}

class Sums {
 public:
  Sums(const Asset& asset, const MotionClip& clip, const EvaluateOptions& options)
      : asset_(asset),
        rebuilder_(asset),
        truncation_(asset.diagonal()),
        total_(asset.diagonal()),
        surface_(rows_of(asset, clip.rest().positions), asset.faces) {
    const std::vector<Vec3> rest = rows_of(asset, clip.rest().positions);
    for (const double fraction : options.levels) levels_.emplace_back(asset, fraction, rest);
  }
  void add(std::span<const Vec3> pose, std::span<const double> sent, std::span<const double> received) {
    const std::vector<Vec3> truth = rows_of(asset_, pose);
    truncation_.add(truth, rebuilder_.rebuild_rows(sent, 3));
    const std::vector<Vec3> rebuilt = rebuilder_.rebuild_rows(received, 3);
    rms_by_frame_.push_back(total_.add(truth, rebuilt));
    surface_.move_to(truth);
    for (LevelErrorSum& level : levels_) level.add(truth, surface_, rebuilt);
  }
  void state(Evaluation& result) {
    result.truncation = truncation_.result();
    result.total = total_.result();
    for (const LevelErrorSum& level : levels_) result.levels.push_back(level.result());
    result.rms_by_frame = std::move(rms_by_frame_);
  }

 private:
  const Asset& asset_;
  SourceRebuilder rebuilder_;
  SurfaceErrorSum truncation_, total_;
  SurfaceDistance surface_;
  std::vector<LevelErrorSum> levels_;
  std::vector<double> rms_by_frame_;
};

}  // namespace

double CodedKeys::payload_kbit_per_s(double rate_hz) const {
  return frames == 0 ? 0 : static_cast<double>(payload_bytes) / static_cast<double>(frames) * 8e-3 * rate_hz;
}

double CodedKeys::wire_kbit_per_s(double rate_hz) const {
  return frames == 0 ? 0 : static_cast<double>(wire_bytes) / static_cast<double>(frames) * 8e-3 * rate_hz;
}

std::optional<double> AgainEvaluation::payback_s(double rate_hz) const {
  const double saved = plain.wire_kbit_per_s(rate_hz) - recalled.wire_kbit_per_s(rate_hz);
  if (saved <= 0) return std::nullopt;
  return static_cast<double>(memory_bytes) * 8e-3 / saved;
}

double AgainEvaluation::in_all_kbit_per_s(const CodedKeys& first, double rate_hz) const {
  const auto frames = static_cast<double>(first.frames + recalled.frames);
  return static_cast<double>(first.wire_bytes + memory_bytes + recalled.wire_bytes) / frames * 8e-3 * rate_hz;
}

double LoopEvaluation::in_all_kbit_per_s() const {
  const auto frames = static_cast<double>(std::max<std::uint64_t>(live.frames, 1));
  return static_cast<double>(live.wire_bytes + memory_bytes) / frames * 8e-3 * options.rate_hz;
}

double eps_from_step(const Asset& asset, double step) {
  return step * asset.diagonal() / 2 * std::sqrt(static_cast<double>(asset.rank));
}

Result<Evaluation> evaluate(const MotionClip& clip, const Asset& asset, const EvaluateOptions& options,
                            const BakeProgress& progress) {
  const auto projector = Projector::create(asset);
  if (!projector) return projector.error();
  const CoefficientLayout layout{options.codec, asset.rank, 3, asset.band_ends};
  const Quantiser quantiser = quantiser_for_error(options.eps, asset.area, asset.rank);

  if ((options.again || options.loop || options.learn) && layout.is_float()) {
    return fail(ErrorCode::kInvalidArgument,
                "a float codec neither remembers nor learns: --again, --loop and --learn need --codec quantised");
  }
  std::optional<CoefficientStore> store;
  if (options.again || options.loop) {
    auto created = CoefficientStore::create(clip.frame_count(), layout.size());
    if (!created) return created.error();
    store = std::move(*created);
  }

  Evaluation result;
  Sums sums(asset, clip, options);
  KeyCoder coder(asset, layout, quantiser);
  JumpFinder jumps(clip.rest());
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    const double done = static_cast<double>(frame) / static_cast<double>(clip.frame_count());
    if (progress && !progress(done, "evaluating")) return fail(ErrorCode::kCancelled, "stopped while evaluating");
    const auto truth = clip.pose(frame);
    if (!truth) return truth.error();
    jumps.add(*truth);
    const auto C =
        projector->coefficients_from_positions(std::span<const double>(truth->front().data(), 3 * truth->size()));
    if (!C) return in_context("frame " + std::to_string(frame), C.error());
    if (store) {
      if (const auto put = store->put(frame, *C); !put) return put.error();
    }
    if (const auto coded = coder.code(*C); !coded) return coded.error();
    sums.add(*truth, *C, coder.received());
    if (frame == clip.frame_count() / 2) {
      const auto still = still_pose(coder, key_from_coefficients(layout, *C, quantiser.step).value(), asset);
      if (!still) return still.error();
      result.still = *still;
    }
  }
  result.keys = coder.keys();
  if (coder.state()) {
    const auto join = encode_join(layout, *coder.state());
    if (!join) return join.error();
    result.join_bytes = join->size();
  }
  if (options.loop && clip.frame_count() > 0) {
    auto loop = evaluate_loop(*options.loop, clip, *store, asset, layout, options.eps, progress);
    if (!loop) return loop.error();
    result.loop = std::move(*loop);
  }
  if (options.again && clip.frame_count() > 0) {
    auto again =
        evaluate_again(*options.again, *store, clip.frame_count(), asset, layout, options.eps, coder.state(), progress);
    if (!again) return again.error();
    result.again = std::move(*again);
  }
  if (options.learn && clip.frame_count() > 0) {
    auto learn = evaluate_learning(clip, asset, options, progress);
    if (!learn) return learn.error();
    result.learn = std::move(*learn);
  }
  sums.state(result);
  if (const auto accepted = accept_order(jumps.order(), options.any_order); !accepted) return accepted.error();
  result.findings = jumps.findings();
  return result;
}

}  // namespace eigencast
