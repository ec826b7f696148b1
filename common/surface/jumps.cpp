// SPDX-License-Identifier: MIT
#include "common/surface/jumps.h"

#include <algorithm>
#include <array>
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
constexpr float kEmpty = 1e-3F;     // of the rest pose's size
constexpr float kOtherSize = 4;     // times or parts of it
constexpr double kScattered = 0.3;  // shortest edges against ways between any two vertices: about 0.55 at random
constexpr std::size_t kFewFaces = 1000;

float median(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::string percent(float fraction) {
  return formatted("%.*f %%", fraction < 0.0995F ? 1 : 0, static_cast<double>(fraction) * 100);
}

double rms_distance(std::span<const Vec3> a, std::span<const Vec3> b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += squared_distance(a[i], b[i]);
  return std::sqrt(sum / static_cast<double>(std::max<std::size_t>(1, a.size())));
}

/// y up for z up and the like: whether some order of the axes, one of them mirrored or not, brings `after` within a quarter of the
/// way back to `before`.
bool axes_exchanged(std::span<const Vec3> before, std::span<const Vec3> after) {
  constexpr std::array<std::array<std::size_t, 3>, 5> kOrders{{{0, 2, 1}, {1, 0, 2}, {2, 1, 0}, {1, 2, 0}, {2, 0, 1}}};
  const double way = rms_distance(before, after);
  std::vector<Vec3> turned(after.size());
  for (const auto& order : kOrders) {
    for (std::size_t mirrored = 0; mirrored <= 3; ++mirrored) {
      for (std::size_t i = 0; i < after.size(); ++i) {
        for (std::size_t c = 0; c < 3; ++c) turned[i][c] = (c == mirrored ? -1 : 1) * after[i][order[c]];
      }
      if (rms_distance(before, turned) < 0.25 * way) return true;
    }
  }
  return false;
}

/// Whether even the shortest edges of faces are as long as ways between any vertices. A mesh of long slivers has short ones; of
/// few faces nothing can be said.
bool joins_at_random(const Surface& surface) {
  if (surface.faces.size() < kFewFaces) return false;
  double edges = 0, ways = 0;
  const std::size_t n = surface.positions.size();
  for (std::size_t f = 0; f < surface.faces.size(); ++f) {
    const Face& face = surface.faces[f];
    const auto edge = [&](std::size_t k) {
      return squared_distance(surface.positions[face[k]], surface.positions[face[(k + 1) % 3]]);
    };
    edges += std::min({edge(0), edge(1), edge(2)});
    ways += squared_distance(surface.positions[f % n], surface.positions[(f + n / 2 + f / 7) % n]);
  }
  return edges > kScattered * kScattered * ways;
}

}  // namespace

JumpFinder::JumpFinder(const Surface& rest)
    : faces_(rest.faces),
      diagonal_(std::max(bounding_box(rest.positions).diagonal(), 1e-30)),
      scattered_(joins_at_random(rest)) {
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
  step.size = static_cast<float>(bounding_box(positions).diagonal() / diagonal_);
  if (rest_edge_length_ > 0 && step.size > kEmpty) step.stretch = edge_length(positions) / rest_edge_length_;
  step.exchanged = step.rms > kFarForSurface && axes_exchanged(before_, positions);
  before_.assign(positions.begin(), positions.end());
  steps_.push_back(step);
}

std::vector<JumpFinder::Jump> JumpFinder::jumps() const {
  std::vector<Jump> kinds(steps_.size(), Jump::kNone);
  std::vector<float> worst;
  for (std::size_t t = 1; t < steps_.size(); ++t) worst.push_back(steps_[t].worst);
  const bool enough = steps_.size() >= 4;
  const float usual_rms = this->usual_rms();
  const float usual_worst = enough ? median(std::move(worst)) : 0;
  bool jumped = false;
  for (std::size_t t = 0; t < steps_.size(); ++t) {
    const Step& step = steps_[t];
    const bool torn = step.stretch > kTornStretch;
    const bool surface = enough && step.rms > kFarForSurface && step.rms > kUnusual * usual_rms;
    const bool vertex = enough && step.worst > kFarForVertex && step.worst > kUnusual * usual_worst &&
                        step.worst > kAloneFactor * step.rms;
    // The way back from a frame that is out of place is no finding of its own.
    const bool returns = jumped && !torn;
    jumped = torn || ((surface || vertex) && !returns);
    if (jumped) kinds[t] = torn ? Jump::kTorn : vertex ? Jump::kVertex : Jump::kSurface;
  }
  return kinds;
}

float JumpFinder::usual_rms() const {
  std::vector<float> rms;
  for (std::size_t t = 1; t < steps_.size(); ++t) rms.push_back(steps_[t].rms);
  return rms.empty() ? 0 : median(std::move(rms));
}

std::string JumpFinder::text_of(const Step& step, Jump kind) const {
  if (kind == Jump::kTorn) {
    return "edges " + formatted("%.0f", std::max(3.0, std::round(double{step.stretch}))) +
           " times as long as in the rest pose; is the order of vertices another?";
  }
  if (kind == Jump::kVertex) {
    return "vertex " + std::to_string(step.vertex) + " jumps by " + percent(step.worst) +
           " of the diagonal, the surface by " + percent(step.rms) + "; has the order of vertices changed?";
  }
  if (step.size < kEmpty) return "all vertices are in one place; is the frame empty?";
  const std::string jump =
      "the surface jumps by " + percent(step.rms) + " of its diagonal, " + percent(usual_rms()) + " is usual; ";
  if (step.size > kOtherSize || step.size < 1 / kOtherSize)
    return jump + "it is " + formatted("%.3g", double{step.size}) +
           " times as large as the rest pose; is it in another unit?";
  return jump + (step.exchanged ? "are its axes exchanged?" : "is the frame out of place?");
}

std::vector<std::string> JumpFinder::findings(std::size_t limit) const {
  std::vector<std::string> lines;
  if (scattered_) {
    lines.push_back(
        "rest pose: its faces join vertices from all over it; are they the faces of another file, or of another order "
        "of "
        "vertices?");
  }
  const std::vector<Jump> kinds = jumps();
  std::size_t more = 0;
  for (std::size_t t = 0; t < kinds.size();) {
    std::size_t end = t + 1;
    while (kinds[t] == Jump::kTorn && end < kinds.size() && kinds[end] == Jump::kTorn) ++end;
    if (kinds[t] != Jump::kNone && lines.size() >= limit) more += end - t;
    if (kinds[t] != Jump::kNone && lines.size() < limit) {
      const std::string last = end > t + 1 ? " to " + std::to_string(end - 1) : "";
      lines.push_back((last.empty() ? "frame " : "frames ") + std::to_string(t) + last + ": " +
                      text_of(steps_[t], kinds[t]));
    }
    t = end;
  }
  if (more > 0) lines.push_back("and " + std::to_string(more) + " more frames");
  return lines;
}

}  // namespace eigencast
