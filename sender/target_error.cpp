// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <algorithm>
#include <cmath>

#include "common/core/text.h"
#include "common/reconstruction/reconstruct.h"
#include "sender/order_check.h"
#include "sender/surface_error.h"

namespace eigencast {
namespace {

constexpr int kFirstRank = 25;
constexpr int kMaxRefinements = 4;
constexpr int kNarrow = 16;  // a bracket of a sixteenth is narrow enough

/// Between a rank that fails and one that does, where a power law through both meets the target; never at either end.
int between(const TriedRank& fails, const TriedRank& meets, double target) {
  const double slope = std::log(fails.error / std::max(meets.error, 1e-300));
  const double share = slope > 0 ? std::log(fails.error / target) / slope : 0.5;
  const double guess = fails.rank * std::pow(static_cast<double>(meets.rank) / fails.rank, share);
  const int margin = std::max(1, (meets.rank - fails.rank) / 8);
  return std::clamp(static_cast<int>(std::ceil(guess)), fails.rank + margin, meets.rank - margin);
}

Error not_met(double target, const RankChoice& choice, bool is_all) {
  const TriedRank& best = choice.tried.back();
  return fail(
      ErrorCode::kInvalidArgument,
      formatted("no basis leaves an rms error of %.2g of the diagonal: the largest, r = %d%s, leaves %.2g; ask for "
                "no less than that, or for another --basis",
                target, best.rank, is_all ? ", all that there are" : "", best.error));
}

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

std::string RankChoice::text(double target) const {
  std::string line =
      formatted("r = %d leaves an rms error of %.2e of the diagonal on the sample poses, %.2e was asked for",
                chosen.rank, chosen.error, target);
  const auto at = std::find_if(tried.begin(), tried.end(), [&](const TriedRank& t) { return t.rank == chosen.rank; });
  if (at != tried.begin()) line += formatted("; r = %d would leave %.2e", std::prev(at)->rank, std::prev(at)->error);
  return line + formatted(" (%zu bases tried)", tried.size());
}

Result<RankChoice> choose_rank(double target, int largest, const std::function<Result<TriedRank>(int rank)>& error_of) {
  RankChoice choice;
  const auto ascending = [](const TriedRank& a, const TriedRank& b) { return a.rank < b.rank; };
  const auto attempt = [&](int rank) {
    auto tried = error_of(rank);
    if (tried)
      choice.tried.insert(std::upper_bound(choice.tried.begin(), choice.tried.end(), *tried, ascending), *tried);
    return tried;
  };
  TriedRank fails;
  for (int rank = std::min(kFirstRank, largest);; rank = std::min(2 * rank, largest)) {
    const auto tried = attempt(rank);
    if (!tried) return tried.error();
    choice.chosen = *tried;
    if (tried->error <= target) break;
    if (rank == largest || tried->rank < rank) return not_met(target, choice, tried->rank < rank);
    fails = *tried;
  }
  for (int i = 0; i < kMaxRefinements && fails.rank > 0; ++i) {
    if (choice.chosen.rank - fails.rank <= std::max(2, choice.chosen.rank / kNarrow)) break;
    const auto tried = attempt(between(fails, choice.chosen, target));
    if (!tried) return tried.error();
    (tried->error <= target ? choice.chosen : fails) = *tried;
  }
  return choice;
}

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
