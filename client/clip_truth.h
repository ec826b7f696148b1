// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/surface/motion_clip.h"
#include "view/pose_source.h"

namespace eigencast {

/// The clip that a stream plays, as the truth of what is shown. The moment of a pose is the nearest point on the
/// polyline through the coefficients of the clip's frames, so that latency is not an error. Not thread-safe.
class ClipTruth final : public Truth {
 public:
  /// frames: the coefficients of each frame, r x 3; source_vertex, origin: those of the asset.
  /// REQUIRES: at least one frame; source_vertex is a permutation of the clip's vertices.
  ClipTruth(std::shared_ptr<const MotionClip> clip, std::vector<std::vector<double>> frames,
            std::vector<std::uint32_t> source_vertex, const std::array<double, 3>& origin);

  bool errors(std::span<const double> C, std::uint32_t channels, std::optional<TimeUs> capture_us,
              std::span<const float> positions, std::span<float> errors) override;
  std::string why() const override { return why_; }

  /// Interpolates from frame `first` to the next (cyclic).
  struct Moment {
    std::size_t first = 0;
    double part = 0;
  };
  Moment moment_of(std::span<const double> C, std::uint32_t channels) const;

 private:
  const std::vector<Vec3>* frame(std::size_t number, std::size_t slot);

  std::shared_ptr<const MotionClip> clip_;
  std::vector<std::vector<double>> frames_;
  std::vector<std::uint32_t> source_vertex_;
  std::array<double, 3> origin_;
  std::array<std::optional<std::size_t>, 2> kept_;
  std::array<std::vector<Vec3>, 2> positions_;
  std::string why_;
};

/// `source` with the clip in `file` (see open_input) as its truth, read in the background when the surface is complete.
std::unique_ptr<PoseSource> with_truth(std::unique_ptr<PoseSource> source, std::string file);

}  // namespace eigencast
