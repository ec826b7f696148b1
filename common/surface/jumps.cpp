// SPDX-License-Identifier: MIT
#include "common/surface/jumps.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "common/core/text.h"
#include "common/surface/surface_distance.h"

namespace eigencast {
namespace {

constexpr float kUnusual = 8;            // times the median step
constexpr float kFarForSurface = 0.05F;  // of the diagonal
constexpr float kFarForVertex = 0.15F;
constexpr float kAloneFactor = 6;  // a vertex that moves so much more than the surface moves alone
constexpr float kTornStretch = 2.5F;

float median(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::string percent(float fraction) {
  return formatted("%.0f %%", static_cast<double>(fraction) * 100);
}

}  // namespace

JumpFinder::JumpFinder(const Surface& rest)
    : faces_(rest.faces), diagonal_(std::max(bounding_box(rest.positions).diagonal(), 1e-30)) {
  rest_edge_length_ = edge_length(rest.positions);
}

float JumpFinder::edge_length(std::span<const Vec3> positions) const {
  double sum = 0;
  for (const Face& face : faces_) {
    for (std::size_t k = 0; k < 3; ++k) sum += squared_distance(positions[face[k]], positions[face[(k + 1) % 3]]);
  }
  const double diagonal = std::max(bounding_box(positions).diagonal(), 1e-30);
  return static_cast<float>(std::sqrt(sum / std::max<double>(1, 3.0 * static_cast<double>(faces_.size()))) / diagonal);
}

void JumpFinder::add(std::span<const Vec3> positions) {
  Step step;
  double sum = 0;
  double worst = 0;
  for (std::size_t i = 0; i < before_.size(); ++i) {
    const double squared = squared_distance(positions[i], before_[i]);
    sum += squared;
    if (squared > worst) {
      worst = squared;
      step.vertex = static_cast<std::uint32_t>(i);
    }
  }
  const double n = static_cast<double>(std::max<std::size_t>(1, positions.size()));
  step.rms = static_cast<float>(std::sqrt(sum / n) / diagonal_);
  step.worst = static_cast<float>(std::sqrt(worst) / diagonal_);
  if (rest_edge_length_ > 0) step.stretch = edge_length(positions) / rest_edge_length_;
  assert(before_.empty() || before_.size() == positions.size());
  before_.assign(positions.begin(), positions.end());
  steps_.push_back(step);
}

std::vector<std::string> JumpFinder::findings(std::size_t limit) const {
  std::vector<std::string> lines;
  if (steps_.size() < 4) return lines;
  std::vector<float> rms, worst;
  for (std::size_t t = 1; t < steps_.size(); ++t) {
    rms.push_back(steps_[t].rms);
    worst.push_back(steps_[t].worst);
  }
  const float usual_rms = median(std::move(rms));
  const float usual_worst = median(std::move(worst));
  std::size_t more = 0;
  bool jumped = false;
  for (std::size_t t = 0; t < steps_.size(); ++t) {
    const Step& step = steps_[t];
    const bool surface_jumps = step.rms > kFarForSurface && step.rms > kUnusual * usual_rms;
    const bool vertex_jumps =
        step.worst > kFarForVertex && step.worst > kUnusual * usual_worst && step.worst > kAloneFactor * step.rms;
    const bool torn = step.stretch > kTornStretch;
    // The way back from a frame that is out of place is no finding of its own.
    const bool returns = jumped && !torn;
    jumped = (surface_jumps || vertex_jumps) && !returns;
    if (!torn && !jumped) continue;
    if (lines.size() == limit) {
      ++more;
      continue;
    }
    std::string line = "frame " + std::to_string(t);
    if (torn) {
      line += ": its edges are " + std::to_string(std::lround(step.stretch)) +
              " times as long as in the rest pose; is the order of its vertices another?";
    } else if (vertex_jumps) {
      line += ": vertex " + std::to_string(step.vertex) + " jumps by " + percent(step.worst) +
              " of the diagonal, the surface by " + percent(step.rms) + "; has the order of vertices changed?";
    } else {
      line += ": the surface jumps by " + percent(step.rms) + " of its diagonal, " + percent(usual_rms) +
              " is usual; is the frame out of place?";
    }
    lines.push_back(std::move(line));
  }
  if (more > 0) lines.push_back("and " + std::to_string(more) + " more frames");
  return lines;
}

}  // namespace eigencast
