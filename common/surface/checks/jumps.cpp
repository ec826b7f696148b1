// SPDX-License-Identifier: MIT
#include "common/surface/checks/jumps.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "common/core/histogram.h"
#include "common/core/text.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

constexpr float kUnusual = 8;            // times the median step
constexpr float kFarForSurface = 0.05F;  // of the diagonal
constexpr float kFarForVertex = 0.15F;
constexpr float kAloneFactor = 6;   // times the surface's: a vertex moves alone
constexpr float kEmpty = 1e-3F;     // of the rest pose's size
constexpr float kOtherSize = 4;     // times or parts of it
constexpr double kElsewhere = 0.5;  // diagonals between the positions of three frames

/// y up for z up and the like: whether some order of the axes, mirrored or not, brings `after` near `before`.
bool axes_exchanged(std::span<const Vec3> before, std::span<const Vec3> after) {
  constexpr std::array<std::array<std::size_t, 3>, 5> kOrders{{{0, 2, 1}, {1, 0, 2}, {2, 1, 0}, {1, 2, 0}, {2, 0, 1}}};
  const double jump = rms_distance(before, after);
  std::vector<Vec3> turned(after.size());
  for (const auto& order : kOrders) {
    for (std::size_t mirrored = 0; mirrored <= 3; ++mirrored) {
      for (std::size_t i = 0; i < after.size(); ++i) {
        for (std::size_t c = 0; c < 3; ++c) turned[i][c] = (c == mirrored ? -1 : 1) * after[i][order[c]];
      }
      if (rms_distance(before, turned) < 0.25 * jump) return true;
    }
  }
  return false;
}

}  // namespace

JumpFinder::JumpFinder(const Surface& rest)
    : order_(rest), diagonal_(std::max(bounding_box(rest.positions).diagonal(), 1e-30)) {}

void JumpFinder::add(std::span<const Vec3> positions) {
  assert(before_.empty() || before_.size() == positions.size());
  Step step;
  double worst = 0;
  for (std::size_t i = 0; i < before_.size(); ++i) {
    const double squared = squared_distance(positions[i], before_[i]);
    if (squared <= worst) continue;
    worst = squared;
    step.vertex = static_cast<std::uint32_t>(i);
  }
  if (!before_.empty()) step.rms = static_cast<float>(rms_distance(before_, positions) / diagonal_);
  step.worst = static_cast<float>(std::sqrt(worst) / diagonal_);
  const Box box = bounding_box(positions);
  step.size = static_cast<float>(box.diagonal() / diagonal_);
  step.exchanged = step.rms > kFarForSurface && axes_exchanged(before_, positions);
  if (step.size > kEmpty) {
    const Misfit misfit = order_.check(positions);
    if (misfit.kind != Misfit::Kind::kNone) misfits_.emplace_back(static_cast<std::uint32_t>(steps_.size()), misfit);
  }
  if (centres_.size() < 3) {
    const Vec3 &low = box.low, &high = box.high;
    centres_.push_back({(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2});
  }
  before_.assign(positions.begin(), positions.end());
  steps_.push_back(step);
}

const Misfit* JumpFinder::misfit_of(std::size_t frame) const {
  const auto at = std::lower_bound(misfits_.begin(), misfits_.end(), frame,
                                   [](const auto& misfit, std::size_t number) { return misfit.first < number; });
  return at != misfits_.end() && at->first == frame ? &at->second : nullptr;
}

bool JumpFinder::is_same_misfit(std::size_t frame, std::size_t other) const {
  const Misfit *a = misfit_of(frame), *b = misfit_of(other);
  return a != nullptr && b != nullptr && a->kind == b->kind;
}

std::size_t JumpFinder::lonely_of_three() const {
  if (steps_.size() != 3) return steps_.size();
  for (std::size_t t = 0; t < 3; ++t) {
    const Vec3 &mine = centres_[t], &one = centres_[(t + 1) % 3], &other = centres_[(t + 2) % 3];
    const double nearest = std::sqrt(std::min(squared_distance(mine, one), squared_distance(mine, other)));
    const bool far = nearest > kElsewhere * diagonal_;
    if (far && nearest > double{kUnusual} * std::sqrt(squared_distance(one, other))) return t;
  }
  return steps_.size();
}

std::vector<JumpFinder::Jump> JumpFinder::jumps() const {
  std::vector<Jump> kinds(steps_.size(), Jump::kNone);
  std::vector<float> worst;
  for (std::size_t t = 1; t < steps_.size(); ++t) worst.push_back(steps_[t].worst);
  const bool enough = steps_.size() >= 4;
  const float usual_rms = this->usual_rms();
  const float usual_worst = enough ? median(std::move(worst)) : 0;
  const std::size_t lonely = lonely_of_three();
  bool jumped = false;
  for (std::size_t t = 0; t < steps_.size(); ++t) {
    const Step& step = steps_[t];
    const bool misfits = misfit_of(t) != nullptr;
    const bool surface = t == lonely || (enough && step.rms > kFarForSurface && step.rms > kUnusual * usual_rms);
    const bool vertex = enough && step.worst > kFarForVertex && step.worst > kUnusual * usual_worst &&
                        step.worst > kAloneFactor * step.rms;
    // The way back from a displaced frame is not a finding of its own.
    const bool returns = jumped && !misfits;
    jumped = misfits || ((surface || vertex) && !returns);
    if (jumped) kinds[t] = misfits ? Jump::kMisfit : vertex ? Jump::kVertex : Jump::kSurface;
  }
  return kinds;
}

float JumpFinder::usual_rms() const {
  std::vector<float> rms;
  for (std::size_t t = 1; t < steps_.size(); ++t) rms.push_back(steps_[t].rms);
  return rms.empty() ? 0 : median(std::move(rms));
}

JumpFinder::Finding JumpFinder::explained(std::size_t frame, Jump kind) const {
  const Step& step = steps_[frame];
  const auto finding = [frame](Cause cause, std::string text) { return Finding{frame, frame, cause, std::move(text)}; };
  if (kind == Jump::kMisfit) {
    const Misfit& misfit = *misfit_of(frame);
    return finding(misfit.kind == Misfit::Kind::kOrder       ? Cause::kOrder
                   : misfit.kind == Misfit::Kind::kInsideOut ? Cause::kInsideOut
                                                             : Cause::kStray,
                   misfit.text());
  }
  if (kind == Jump::kVertex) {
    return finding(Cause::kVertex, "vertex " + std::to_string(step.vertex) + " jumps by " + percent_text(step.worst) +
                                       " of the diagonal, the surface by " + percent_text(step.rms) +
                                       "; has the order of vertices changed?");
  }
  if (step.size < kEmpty) return finding(Cause::kEmpty, "all vertices are at one position; is the frame empty?");
  const bool few = steps_.size() < 4;
  const std::string jump = few ? "the surface is far from where the other two frames are; "
                               : "the surface jumps by " + percent_text(step.rms) + " of its diagonal, " +
                                     percent_text(usual_rms()) + " is usual; ";
  if (step.size > kOtherSize || step.size < 1 / kOtherSize) {
    return finding(Cause::kUnit, jump + "it is " + formatted("%.3g", double{step.size}) +
                                     " times as large as the rest pose; is it in another unit?");
  }
  if (step.exchanged) return finding(Cause::kAxes, jump + "are its axes exchanged?");
  return finding(Cause::kPosition, jump + "is the frame out of place?");
}

std::vector<JumpFinder::Finding> JumpFinder::found() const {
  std::vector<Finding> all;
  const std::vector<Jump> kinds = jumps();
  for (std::size_t t = 0; t < kinds.size(); ++t) {
    if (kinds[t] == Jump::kNone) continue;
    all.push_back(explained(t, kinds[t]));
    while (kinds[t] == Jump::kMisfit && t + 1 < kinds.size() && is_same_misfit(all.back().first, t + 1)) ++t;
    all.back().last = t;
  }
  return all;
}

std::vector<std::string> JumpFinder::findings(std::size_t limit) const {
  std::vector<std::string> lines;
  std::size_t more = 0;
  for (const Finding& finding : found()) {
    if (lines.size() >= limit) {
      more += finding.last + 1 - finding.first;
    } else if (finding.first == finding.last) {
      lines.push_back("frame " + std::to_string(finding.first) + ": " + finding.text);
    } else {
      lines.push_back("frames " + std::to_string(finding.first) + " to " + std::to_string(finding.last) + ": " +
                      finding.text);
    }
  }
  if (more > 0) lines.push_back("and " + std::to_string(more) + " more frames");
  return lines;
}

std::string JumpFinder::rest_finding() const {
  if (order_.rest().kind == Misfit::Kind::kNone) return {};
  return "rest pose: its faces join vertices that are not neighbours, " + order_.rest().text();
}

Result<void> JumpFinder::order() const {
  const auto certain =
      std::count_if(misfits_.begin(), misfits_.end(), [](const auto& misfit) { return misfit.second.certain; });
  if (!order_.rest().certain && 2 * static_cast<std::size_t>(certain) <= steps_.size()) return {};
  const std::string where =
      order_.rest().certain ? "the mesh"
                            : std::to_string(certain) + " of the " + std::to_string(steps_.size()) + " frames checked";
  return fail(ErrorCode::kInvalidArgument,
              where +
                  ": the faces join vertices that are not neighbours; they are of another file, or of another order of "
                  "vertices: export mesh and clip together, with the order of vertices kept");
}

}  // namespace eigencast
