// SPDX-License-Identifier: MIT
#include "sender/evaluate_learning.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <utility>

#include "common/codec/pose_memory.h"
#include "common/codec/recaller.h"
#include "common/reconstruction/reconstruct.h"
#include "common/surface/vector.h"
#include "sender/clip_coefficients.h"
#include "sender/key_coder.h"
#include "sender/performance.h"

namespace eigencast {
namespace {

constexpr double kFarthest = 8;  ///< From the error that quantising may add to that of as many bits.
constexpr int kSteps = 9;        ///< On the way there.

struct TruePose {
  std::vector<double> C;
  std::vector<Vec3> rows;  ///< In the asset's order and space.
};

/// Poses one after the other; nothing at the end.
using PoseSource = std::function<Result<std::optional<TruePose>>()>;

/// A surface, and the clip's coefficients on it.
struct Projected {
  const Asset& asset;
  CoefficientLayout layout;
  CoefficientStore store;

  static Result<Projected> create(const MotionClip& clip, const Asset& asset) {
    const auto projector = Projector::create(asset);
    if (!projector) return projector.error();
    CoefficientLayout layout{CodecKind::kQuantised, asset.rank, 3, asset.band_ends};
    auto store = CoefficientStore::create(clip.frame_count(), layout.size());
    if (!store) return store.error();
    for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
      const auto pose = clip.pose(frame);
      if (!pose) return pose.error();
      const auto C = projector->coefficients_from_positions({pose->front().data(), 3 * pose->size()});
      if (!C) return C.error();
      if (const auto put = store->put(frame, *C); !put) return put.error();
    }
    return Projected{asset, std::move(layout), std::move(*store)};
  }
  Quantiser quantiser(double eps) const { return quantiser_for_error(eps, asset.area, asset.rank); }
};

Result<JudgedKeys> judge(const Projected& with, double eps, const PoseMemory* memory, const PoseSource& poses) {
  KeyCoder coder(with.asset, with.layout, with.quantiser(eps), {}, memory);
  SourceRebuilder rebuilder(with.asset);
  SurfaceErrorSum error(with.asset.diagonal());
  for (;;) {
    const auto pose = poses();
    if (!pose) return pose.error();
    if (!*pose) break;
    if (const auto coded = coder.code((*pose)->C); !coded) return coded.error();
    error.add((*pose)->rows, rebuilder.rebuild_rows(coder.received(), 3));
  }
  return JudgedKeys{coder.keys(), error.result(), eps};
}

Result<PoseMemory> memory_of(const Projected& with, std::size_t frames, double eps) {
  const Quantiser quantiser = with.quantiser(eps);
  std::vector<Key> keys;
  while (keys.size() < frames && PoseMemory::check_size(with.layout, keys.size() + 1)) {
    const auto C = with.store.at(keys.size());
    if (!C) return C.error();
    auto key = key_from_coefficients(with.layout, *C, quantiser.step);
    if (!key) return key.error();
    keys.push_back(std::move(*key));
  }
  const auto segment = encode_segment(with.layout, {}, keys, remembered_half_spacing(quantiser.half_spacing));
  if (!segment) return segment.error();
  return PoseMemory(with.layout).with(segment->segment);
}

class Learning {
 public:
  Learning(const MotionClip& clip, const EvaluateOptions& options, const Projected& plain, const Projected& learnt)
      : clip_(clip), options_(options), plain_(plain), learnt_(learnt), noise_(learnt.asset) {}

  /// Of the frames from `first` on.
  Result<LearningGain> rest(std::size_t first) {
    auto gain = both(nullptr, nullptr, [&](const Projected& with) { return frames(with, first); });
    if (!gain) return gain;
    double fine = options_.eps / kFarthest, coarse = options_.eps * kFarthest;
    for (int i = 0; i < kSteps; ++i) {
      const double middle = std::sqrt(fine * coarse);
      auto tried = judge(learnt_, middle, nullptr, frames(learnt_, first));
      if (!tried) return tried.error();
      const bool is_more = tried->keys.wire_bytes > gain->plain.keys.wire_bytes;
      (is_more ? fine : coarse) = middle;
      if (!is_more || coarse == options_.eps * kFarthest) gain->other = std::move(*tried);
    }
    return gain;
  }
  Result<LearningGain> again() {
    const auto plain = memory_of(plain_, clip_.frame_count(), options_.eps);
    const auto learnt = memory_of(learnt_, clip_.frame_count(), options_.eps);
    if (!plain || !learnt) return plain ? learnt.error() : plain.error();
    auto gain = both(&*plain, &*learnt, [&](const Projected& with) { return passes(with); });
    if (!gain) return gain;
    auto without = judge(plain_, options_.eps, nullptr, passes(plain_));
    if (!without) return without.error();
    gain->other = std::move(*without);
    return gain;
  }

 private:
  template <typename Source>
  Result<LearningGain> both(const PoseMemory* plain_memory, const PoseMemory* learnt_memory, const Source& source) {
    auto plain = judge(plain_, options_.eps, plain_memory, source(plain_));
    auto learnt = judge(learnt_, options_.eps, learnt_memory, source(learnt_));
    if (!plain || !learnt) return plain ? learnt.error() : plain.error();
    return LearningGain{std::move(*plain), std::move(*learnt), {}};
  }

  PoseSource frames(const Projected& with, std::size_t first) {
    return [this, &with, frame = first]() mutable -> Result<std::optional<TruePose>> {
      if (frame == clip_.frame_count()) return std::optional<TruePose>();
      TruePose pose;
      auto C = with.store.at(frame);
      if (!C) return C.error();
      pose.C = std::move(*C);
      const auto truth = clip_.pose(frame++);
      if (!truth) return truth.error();
      pose.rows = rows_of(with.asset, *truth);
      return std::optional(std::move(pose));
    };
  }

  /// The noise is the same in both.
  PoseSource passes(const Projected& with) {
    auto performance =
        std::make_shared<Performance>(learnt_.store, clip_.frame_count(), learnt_.asset, *options_.again);
    return [this, &with, performance, pass = 1U]() mutable -> Result<std::optional<TruePose>> {
      for (;;) {
        auto next = performance->next();
        if (!next) return next.error();
        if (*next) return true_pose(with, **next);
        performance->restart();
        if (++pass == options_.again->passes) return std::optional<TruePose>();
      }
    };
  }
  Result<std::optional<TruePose>> true_pose(const Projected& with, const Performance::Pose& performed) {
    TruePose pose;
    pose.C.assign(performed.noise.begin(), performed.noise.begin() + static_cast<std::ptrdiff_t>(with.layout.size()));
    pose.rows = noise_.rebuild_rows(performed.noise, 3);
    for (std::size_t k = 0; k < performed.frames.size(); ++k) {
      const auto C = with.store.at(performed.frames[k]);
      if (!C) return C.error();
      for (std::size_t i = 0; i < C->size(); ++i) pose.C[i] += performed.weights[k] * (*C)[i];
      const auto truth = clip_.pose(performed.frames[k]);
      if (!truth) return truth.error();
      const std::vector<Vec3> rows = rows_of(with.asset, *truth);
      for (std::size_t row = 0; row < rows.size(); ++row)
        pose.rows[row] = pose.rows[row] + performed.weights[k] * rows[row];
    }
    return std::optional(std::move(pose));
  }

  const MotionClip& clip_;
  const EvaluateOptions& options_;
  const Projected& plain_;
  const Projected& learnt_;
  SourceRebuilder noise_;
};

/// From the first poses alone.
Result<LearntColumns> learn(const MotionClip& clip, const Projected& plain, const EvaluateOptions& options,
                            LearnEvaluation& result) {
  Learner learner(std::shared_ptr<const Asset>(std::shared_ptr<const Asset>(), &plain.asset));
  std::vector<float> positions;
  for (std::size_t frame = 0; frame < result.poses; ++frame) {
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    const auto C = plain.store.at(frame);
    if (!C) return C.error();
    positions.clear();
    for (const Vec3& p : *pose) positions.insert(positions.end(), p.begin(), p.end());
    const auto start = std::chrono::steady_clock::now();
    learner.add(positions, *C);
    result.add_ns.add(std::chrono::nanoseconds(std::chrono::steady_clock::now() - start).count());
  }
  Histogram ns;
  LearntColumns columns = timed(ns, [&] { return learner.columns(options.eps); });
  result.learn_ms = ns.mean() * 1e-6;
  result.columns = static_cast<std::uint32_t>(columns.amplitudes.size());
  result.trial = learner.trial(options.eps, options.learn->rate_hz);
  return columns;
}

}  // namespace

Result<LearnEvaluation> evaluate_learning(const MotionClip& clip, const Asset& asset, const EvaluateOptions& options,
                                          const BakeProgress& progress) {
  if (const auto able = check_columns(asset, Learner::kMaxColumns); !able) return able.error();
  const auto stopped = [&](double done) { return progress && !progress(done, "learning"); };
  if (stopped(0)) return fail(ErrorCode::kCancelled, "stopped while evaluating");
  const auto plain = Projected::create(clip, asset);
  if (!plain) return plain.error();
  LearnEvaluation result;
  result.options = *options.learn;
  const double window = std::max(1.0, std::ceil(options.learn->seconds * options.learn->rate_hz));
  result.poses = std::min(clip.frame_count(), static_cast<std::size_t>(window));
  const auto columns = learn(clip, *plain, options, result);
  if (!columns) return columns.error();
  if (result.columns == 0) return result;
  const auto encoded = encode_columns(asset, *options.learn->encoded, columns->columns);
  if (!encoded) return encoded.error();
  result.bytes = encoded->section.bytes.size() + encoded->manifest.bytes.size();
  result.pays = result.trial && result.trial->pays(result.bytes);
  const auto wider = learnt_asset(asset, *encoded);
  if (!wider) return wider.error();
  const auto learnt = Projected::create(clip, *wider);
  if (!learnt) return learnt.error();
  Learning learning(clip, options, *plain, *learnt);
  if (clip.frame_count() > result.poses + 1) {
    if (stopped(0.3)) return fail(ErrorCode::kCancelled, "stopped while evaluating");
    auto rest = learning.rest(result.poses);
    if (!rest) return rest.error();
    result.rest = std::move(*rest);
  }
  if (options.again) {
    if (stopped(0.7)) return fail(ErrorCode::kCancelled, "stopped while evaluating");
    auto again = learning.again();
    if (!again) return again.error();
    result.again = std::move(*again);
  }
  return result;
}

}  // namespace eigencast
