// SPDX-License-Identifier: MIT
#include "sender/recorded_motion.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "common/motion/clip_motion.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/recorded_clip.h"

namespace eigencast {
namespace {

/// In the source's order of vertices and faces' corners.
Appearance appearance_of(const Asset& asset) {
  Appearance result;
  if (!asset.colours.empty()) {
    result.vertex_colour.resize(asset.colours.size());
    for (std::size_t row = 0; row < asset.colours.size(); ++row)
      result.vertex_colour[asset.source_vertex[row]] = asset.colours[row];
  }
  if (asset.texture == nullptr) return result;
  const AssetTexture& texture = *asset.texture;
  const bool is_png = texture.image.size() > 1 && texture.image[0] == 0x89 && texture.image[1] == 'P';
  result.images.push_back({"texture", is_png ? "image/png" : "image/jpeg", texture.image});
  result.materials.push_back({"textured", {1, 1, 1, 1}, 0});
  for (const Corners& wedges : texture.corners) {
    const bool is_in_it =
        std::all_of(wedges.begin(), wedges.end(), [&](auto w) { return texture.uvs[w] != AssetTexture::kNone; });
    result.face_material.push_back(is_in_it ? 0 : -1);
    auto& corners = result.corner_uv.emplace_back();
    for (std::size_t c = 0; is_in_it && c < 3; ++c) corners[c] = texture.uv(wedges[c]);
  }
  return result;
}

class RecordedMotion final : public MotionClip {
 public:
  RecordedMotion(std::string path, RecordedClip clip, double rate_hz)
      : path_(std::move(path)),
        clip_(std::move(clip)),
        rate_hz_(rate_hz > 0 ? rate_hz : clip_.info.key_rate_hz),
        appearance_(appearance_of(clip_.asset)) {
    const Asset& asset = clip_.asset;
    reconstructor_.update(asset);
    rest_.positions = rebuilt(asset.rest, 3);
    for (const Corners& rows : asset.faces) {
      Face& face = rest_.faces.emplace_back();
      for (std::size_t c = 0; c < 3; ++c) face[c] = asset.source_vertex[rows[c]];
    }
  }

  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override {
    // As many as begin before the recording ends; times are rounded to microseconds.
    const double frames = std::ceil(1e-6 * static_cast<double>(clip_.period_us()) * rate_hz_ - 0.5);
    return std::clamp(static_cast<std::size_t>(std::max(frames, 1.0)), std::size_t{1}, kMaxClipFrames);
  }
  double frame_rate_hz() const override { return rate_hz_; }
  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    const auto time_us = static_cast<TimeUs>(std::llround(1e6 * static_cast<double>(frame) / rate_hz_));
    const ClipMotion curve{clip_.frames, clip_.times_us, clip_.period_us(), false};
    return rebuilt(curve.at(time_us, false), clip_.info.format.channels);
  }
  std::string name() const override { return path_; }
  std::vector<std::string> notes() const override {
    return {"a recording of " + clip_.info.stream + ", of " + std::to_string(clip_.asset.rank) + " coefficients"};
  }
  const Appearance* appearance() const override { return &appearance_; }

 private:
  std::vector<Vec3> rebuilt(std::span<const double> C, std::uint32_t channels) const {
    const Asset& asset = clip_.asset;
    std::vector<float> rows(std::size_t{3} * asset.vertex_count);
    reconstructor_.rebuild(C, channels, asset.rank, asset.vertex_count, rows);
    std::vector<Vec3> positions(asset.vertex_count);
    for (std::size_t row = 0; row < positions.size(); ++row) {
      for (std::size_t d = 0; d < 3; ++d)
        positions[asset.source_vertex[row]][d] = double{rows[3 * row + d]} + asset.origin[d];
    }
    return positions;
  }

  const std::string path_;
  const RecordedClip clip_;
  const double rate_hz_;
  const Appearance appearance_;
  Reconstructor reconstructor_;
  Surface rest_;
};

}  // namespace

Result<std::unique_ptr<MotionClip>> open_recorded_motion(const std::string& path, const std::string& cache_dir,
                                                         double rate_hz) {
  auto clip = read_recording(path, cache_dir);
  if (!clip) return clip.error();
  return std::unique_ptr<MotionClip>(std::make_unique<RecordedMotion>(path, *std::move(clip), rate_hz));
}

}  // namespace eigencast
