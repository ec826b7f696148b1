// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/surface/formats/gltf_scene.h"

/// Private to common/surface.
namespace eigencast {

/// One of a file's animations: curves over time, after glTF 2.0, appendix C.
class GltfAnimation {
 public:
  /// `which`: name or number; empty: the first; a file without any gives one that moves nothing. Errors: kNotFound
  /// (listing those there are), kCorrupt.
  static Result<GltfAnimation> from_model(const tinygltf::Model& model, GltfNumbers& numbers, const GltfScene& scene,
                                          const std::string& which);

  double start_s() const { return start_s_; }
  double end_s() const { return end_s_; }
  void apply(double time_s, GltfPose& pose) const;

 private:
  enum class Path { kTranslation, kRotation, kScale, kWeights };
  enum class Interpolation { kLinear, kStep, kCubicSpline };
  struct Track {
    Path path;
    Interpolation interpolation;
    std::size_t node;
    std::size_t width;  ///< Numbers of a value.
    std::vector<double> times;
    std::vector<double> values;  ///< times x width; cubic: times x 3 x width (in-tangent, value, out-tangent).
  };
  static Result<Track> track_from(const tinygltf::Animation& animation, const tinygltf::AnimationChannel& channel,
                                  Path path, GltfNumbers& numbers, const GltfScene& scene);
  static void sample(const Track& track, double time_s, std::vector<double>& value);

  std::vector<Track> tracks_;
  std::vector<std::pair<std::size_t, std::size_t>> weights_;  ///< Each track's first target and how many.
  double start_s_ = 0;
  double end_s_ = 0;
};

}  // namespace eigencast
