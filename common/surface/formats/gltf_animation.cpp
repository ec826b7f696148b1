// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_animation.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <optional>
#include <string_view>

namespace eigencast {
namespace {

constexpr std::string_view kPaths[] = {"translation", "rotation", "scale", "weights"};  // as GltfAnimation::Path

std::optional<std::size_t> find_animation(const tinygltf::Model& model, const std::string& which) {
  for (std::size_t i = 0; i < model.animations.size(); ++i) {
    if (model.animations[i].name == which || std::to_string(i) == which) return i;
  }
  return std::nullopt;
}

void normalise(double* q) {
  const double length = std::sqrt(std::inner_product(q, q + 4, q, 0.0));
  if (length > 1e-12) {
    for (std::size_t c = 0; c < 4; ++c) q[c] /= length;
  } else {
    std::fill(q, q + 3, 0.0);
    q[3] = 1;
  }
}

// Spherical linear interpolation of unit quaternions, the short way.
void slerp(const double* a, const double* b, double t, double* out) {
  double dot = std::inner_product(a, a + 4, b, 0.0);
  const double sign = dot < 0 ? -1 : 1;
  dot = std::min(1.0, dot * sign);
  const double angle = std::acos(dot);
  const double sine = std::sin(angle);
  const double wa = sine > 1e-6 ? std::sin((1 - t) * angle) / sine : 1 - t;
  const double wb = sine > 1e-6 ? std::sin(t * angle) / sine : t;
  for (std::size_t c = 0; c < 4; ++c) out[c] = wa * a[c] + sign * wb * b[c];
  normalise(out);
}

}  // namespace

Result<GltfAnimation::Track> GltfAnimation::track_from(const tinygltf::Animation& animation,
                                                       const tinygltf::AnimationChannel& channel, Path path,
                                                       GltfNumbers& numbers, const GltfScene& scene) {
  Track track;
  track.path = path;
  track.node = static_cast<std::size_t>(channel.target_node);
  const tinygltf::AnimationSampler* sampler = element(animation.samplers, channel.sampler);
  if (sampler == nullptr) return corrupt_gltf("a channel has no sampler");
  track.interpolation = sampler->interpolation == "STEP"          ? Interpolation::kStep
                        : sampler->interpolation == "CUBICSPLINE" ? Interpolation::kCubicSpline
                                                                  : Interpolation::kLinear;
  auto times = numbers.read(sampler->input, 1);
  if (!times) return times.error();
  track.times = std::move(times->values);
  if (track.times.empty() || !std::is_sorted(track.times.begin(), track.times.end()))
    return corrupt_gltf("the times of a sampler do not ascend");
  const bool is_weights = path == Path::kWeights;
  auto values = numbers.read(sampler->output, is_weights ? 1 : path == Path::kRotation ? 4 : 3);
  if (!values) return values.error();
  const std::size_t knots = track.times.size() * (track.interpolation == Interpolation::kCubicSpline ? 3 : 1);
  track.width = is_weights ? scene.nodes[track.node].target_count : values->width;
  if (values->values.size() != knots * track.width) {
    return corrupt_gltf("a sampler has " + std::to_string(values->values.size()) + " numbers where " +
                        std::to_string(knots * track.width) + " are needed");
  }
  track.values = std::move(values->values);
  if (path == Path::kRotation && track.interpolation != Interpolation::kCubicSpline) {
    for (std::size_t k = 0; k < knots; ++k) normalise(&track.values[4 * k]);
  }
  return track;
}

Result<GltfAnimation> GltfAnimation::from_model(const tinygltf::Model& model, GltfNumbers& numbers,
                                                const GltfScene& scene, const std::string& which) {
  GltfAnimation result;
  if (model.animations.empty() && which.empty()) return result;
  const auto index = which.empty() ? std::optional<std::size_t>(0) : find_animation(model, which);
  if (!index) {
    std::string names;
    for (const tinygltf::Animation& animation : model.animations) names += (names.empty() ? "" : ", ") + animation.name;
    return fail(ErrorCode::kNotFound, "no animation \"" + which + "\"; there are: " + (names.empty() ? "none" : names));
  }
  const tinygltf::Animation& animation = model.animations[*index];
  for (const tinygltf::AnimationChannel& channel : animation.channels) {
    const auto name = std::find(std::begin(kPaths), std::end(kPaths), channel.target_path);
    const GltfScene::Node* moved = element(scene.nodes, channel.target_node);
    if (name == std::end(kPaths) || moved == nullptr) continue;
    const auto path = static_cast<Path>(name - std::begin(kPaths));
    const GltfScene::Node& node = *moved;
    if (node.fixed && path != Path::kWeights) return corrupt_gltf("an animated node states a matrix");
    if (path == Path::kWeights && node.target_count == 0) continue;
    auto track = track_from(animation, channel, path, numbers, scene);
    if (!track) return in_context("animation " + std::to_string(*index), track.error());
    const bool first = result.tracks_.empty();
    result.start_s_ = first ? track->times.front() : std::min(result.start_s_, track->times.front());
    result.end_s_ = first ? track->times.back() : std::max(result.end_s_, track->times.back());
    result.weights_.emplace_back(node.first_target, node.target_count);
    result.tracks_.push_back(std::move(*track));
  }
  return result;
}

void GltfAnimation::sample(const Track& track, double time_s, std::vector<double>& value) {
  const std::size_t w = track.width;
  const bool cubic = track.interpolation == Interpolation::kCubicSpline;
  const auto knot = [&](std::size_t k, std::size_t part) {
    return track.values.data() + (cubic ? 3 * k + part : k) * w;
  };
  value.resize(w);
  const auto after = std::upper_bound(track.times.begin(), track.times.end(), time_s);
  const auto next = static_cast<std::size_t>(after - track.times.begin());
  if (next == 0 || next == track.times.size() || track.interpolation == Interpolation::kStep) {
    std::copy_n(knot(next == 0 ? 0 : next - 1, 1), w, value.begin());
    if (cubic && track.path == Path::kRotation) normalise(value.data());
    return;
  }
  const double interval = track.times[next] - track.times[next - 1];
  const double t = (time_s - track.times[next - 1]) / interval;
  if (cubic) {
    const double t2 = t * t;
    const double t3 = t2 * t;
    for (std::size_t c = 0; c < w; ++c) {
      value[c] = (2 * t3 - 3 * t2 + 1) * knot(next - 1, 1)[c] + interval * (t3 - 2 * t2 + t) * knot(next - 1, 2)[c] +
                 (3 * t2 - 2 * t3) * knot(next, 1)[c] + interval * (t3 - t2) * knot(next, 0)[c];
    }
    if (track.path == Path::kRotation) normalise(value.data());
  } else if (track.path == Path::kRotation) {
    slerp(knot(next - 1, 0), knot(next, 0), t, value.data());
  } else {
    for (std::size_t c = 0; c < w; ++c) value[c] = (1 - t) * knot(next - 1, 0)[c] + t * knot(next, 0)[c];
  }
}

void GltfAnimation::apply(double time_s, GltfPose& pose) const {
  std::vector<double> value;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    const Track& track = tracks_[i];
    sample(track, time_s, value);
    GltfPose::Local& local = pose.nodes[track.node];
    switch (track.path) {
      case Path::kTranslation:
        std::copy_n(value.begin(), 3, local.translation.begin());
        break;
      case Path::kRotation:
        std::copy_n(value.begin(), 4, local.rotation.begin());
        break;
      case Path::kScale:
        std::copy_n(value.begin(), 3, local.scale.begin());
        break;
      case Path::kWeights:
        std::copy_n(value.begin(), weights_[i].second,
                    pose.weights.begin() + static_cast<std::ptrdiff_t>(weights_[i].first));
        break;
    }
  }
}

}  // namespace eigencast
