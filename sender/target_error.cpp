// SPDX-License-Identifier: MIT
#include "sender/target_error.h"

#include "common/reconstruction/reconstruct.h"
#include "sender/order_check.h"
#include "sender/surface_error.h"

namespace eigencast {
namespace {

constexpr std::size_t kSamples = 24;
constexpr int kLargestRank = 512;

Result<std::unique_ptr<MotionClip>> open_samples(const SourceOptions& options) {
  SourceOptions poses = options;
  if (!options.poses.empty()) poses.input = options.poses, poses.rest.clear(), poses.faces.clear();
  auto clip = open_source(poses);
  if (!clip || (*clip)->frame_count() > 1) return clip;
  return fail(
      ErrorCode::kInvalidArgument,
      poses.input + " is a single pose, which says nothing of the error in motion: --target-error needs --poses CLIP");
}

/// Before any basis is made.
Result<std::string> check_samples(const SourceOptions& options, const MotionClip& samples) {
  const auto frames = sample_frames(samples.frame_count(), kSamples);
  if (options.poses.empty()) return check_frames(samples.rest(), samples, frames, options.any_order);
  const auto input = open_source(options);
  if (!input) return input.error();
  return check_frames((*input)->rest(), samples, frames, options.any_order);
}

}  // namespace

Result<double> error_on_samples(const Asset& asset, const MotionClip& clip) {
  const auto projector = Projector::create(asset);
  if (!projector) return projector.error();
  SourceRebuilder rebuilder(asset);
  SurfaceErrorSum sum(asset.diagonal());
  for (const std::size_t frame : sample_frames(clip.frame_count(), kSamples)) {
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    const auto C =
        projector->coefficients_from_positions(std::span<const double>(pose->front().data(), 3 * pose->size()));
    if (!C) return in_context("sample pose " + std::to_string(frame), C.error());
    sum.add(*pose, rebuilder.rebuild(*C, 3));
  }
  return sum.result().rms;
}

Result<Source> bake_for_target(const SourceOptions& options, const BakeProgress& progress) {
  const auto clip = open_samples(options);
  if (!clip) return clip.error();
  const auto misfit = check_samples(options, **clip);
  if (!misfit) return misfit.error();
  Source best;
  const auto attempt = [&](int rank) -> Result<TriedRank> {
    SourceOptions with_rank = options;
    with_rank.rank = rank;
    const std::string trying = "r = " + std::to_string(rank) + ": ";
    auto source = bake_source(with_rank, [&](double fraction, std::string_view stage) {
      return !progress || progress(fraction, trying + std::string(stage));
    });
    if (!source) return source.error();
    const auto error = error_on_samples(source->baked.asset, **clip);
    if (!error) return error.error();
    const TriedRank tried{static_cast<int>(source->baked.asset.rank), *error};
    if (tried.error <= options.target_error)
      best = std::move(*source);  // Each that does is smaller than the one before.
    return tried;
  };
  auto choice = choose_rank(options.target_error, kLargestRank, attempt);
  if (!choice) return in_context(options.input, choice.error());
  best.rank_choice = std::move(*choice);
  if (!misfit->empty()) best.findings.push_back(*misfit);
  return best;
}

}  // namespace eigencast
