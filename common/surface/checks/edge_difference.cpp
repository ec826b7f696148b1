// SPDX-License-Identifier: MIT
#include "common/surface/checks/edge_difference.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "common/surface/checks/surface_distance.h"

namespace eigencast {
namespace {

constexpr std::size_t kWindow = 3;

/// Standard deviation of the relative differences of some edges, weighted by their lengths.
class Deviation {
 public:
  void add(double length, double difference) {
    weight_ += length;
    sum_ += length * difference;
    squares_ += length * difference * difference;
  }
  double value() const {
    if (!(weight_ > 0)) return 0;
    const double mean = sum_ / weight_;
    return std::sqrt(std::max(0.0, squares_ / weight_ - mean * mean));
  }

 private:
  double weight_ = 0, sum_ = 0, squares_ = 0;
};

double relative_difference(double length, double rebuilt) {
  return length > 0 ? std::abs(length - rebuilt) / length : 0;
}

double mean(double sum, std::size_t frames, std::size_t vertices) {
  return frames == 0 || vertices == 0 ? 0 : sum / static_cast<double>(frames) / static_cast<double>(vertices);
}

}  // namespace

double EdgeDifferenceError::combined() const {
  return std::hypot(spatial, EdgeDifference::kTemporalWeight * temporal);
}

EdgeDifference::EdgeDifference(std::size_t vertex_count, std::span<const Face> faces, double diagonal)
    : first_(vertex_count + 1, 0), squared_time_step_(kTimeStep * kTimeStep * diagonal * diagonal) {
  for (const Face& face : faces) {
    for (std::size_t k = 0; k < 3; ++k) edges_.push_back(std::minmax({face[k], face[(k + 1) % 3]}));
  }
  std::sort(edges_.begin(), edges_.end());
  edges_.erase(std::unique(edges_.begin(), edges_.end()), edges_.end());
  for (const auto& [a, b] : edges_) {
    ++first_[a + 1];
    ++first_[b + 1];
  }
  for (std::size_t i = 0; i < vertex_count; ++i) first_[i + 1] += first_[i];
  incident_.resize(first_.back());
  std::vector<std::uint32_t> next(first_.begin(), first_.end() - 1);
  for (std::uint32_t e = 0; e < edges_.size(); ++e) {
    incident_[next[edges_[e].first]++] = e;
    incident_[next[edges_[e].second]++] = e;
  }
  stretched_.resize(edges_.size());
}

void EdgeDifference::add(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  assert(truth.size() + 1 == first_.size() && rebuilt.size() == truth.size());
  if (edges_.empty()) return;
  for (std::size_t e = 0; e < edges_.size(); ++e) {
    const auto& [a, b] = edges_[e];
    const double length = std::sqrt(squared_distance(truth[a], truth[b]));
    stretched_[e] = {length, relative_difference(length, std::sqrt(squared_distance(rebuilt[a], rebuilt[b])))};
  }
  for (std::size_t i = 0; i < truth.size(); ++i) {
    Deviation deviation;
    for (std::uint32_t k = first_[i]; k < first_[i + 1]; ++k) {
      const Edge& edge = stretched_[incident_[k]];
      deviation.add(edge.length, edge.difference);
    }
    spatial_ += deviation.value();
  }
  if (frames_++ > 0) add_step(truth, rebuilt);
  truth_before_.assign(truth.begin(), truth.end());
  rebuilt_before_.assign(rebuilt.begin(), rebuilt.end());
}

void EdgeDifference::add_step(std::span<const Vec3> truth, std::span<const Vec3> rebuilt) {
  std::vector<Edge> step(truth.size());
  for (std::size_t i = 0; i < step.size(); ++i) {
    const double length = std::sqrt(squared_distance(truth[i], truth_before_[i]) + squared_time_step_);
    const double other = std::sqrt(squared_distance(rebuilt[i], rebuilt_before_[i]) + squared_time_step_);
    step[i] = {length, relative_difference(length, other)};
  }
  steps_.push_back(std::move(step));
  if (steps_.size() < kWindow) return;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    Deviation deviation;
    for (const std::vector<Edge>& edges : steps_) deviation.add(edges[i].length, edges[i].difference);
    temporal_ += deviation.value();
  }
  ++windows_;
  steps_.pop_front();
}

EdgeDifferenceError EdgeDifference::result() const {
  const std::size_t vertices = first_.size() - 1;
  return {mean(spatial_, frames_, vertices), mean(temporal_, windows_, vertices)};
}

}  // namespace eigencast
