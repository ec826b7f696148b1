// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/vec3.hpp>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/core/bands.h"
#include "common/core/clock.h"
#include "common/motion/coefficients.h"
#include "common/motion/playout.h"
#include "common/reconstruction/level_morph.h"
#include "common/reconstruction/level_triangles.h"
#include "common/reconstruction/reconstruct.h"
#include "view/pose_source.h"
#include "view/rebuild.h"

namespace eigencast {

/// The fraction of an asset's vertices that its user wants drawn. Not thread-safe.
class LevelOfDetail {
 public:
  static constexpr double kStep = 1.25;  ///< One key press multiplies or divides the fraction by this.
  static constexpr double kMin = 1.0 / 1024;

  /// Clamped to [kMin, 1].
  explicit LevelOfDetail(double fraction = 1) { set_fraction(fraction); }

  void set_fraction(double fraction) { fraction_ = std::isfinite(fraction) ? std::clamp(fraction, kMin, 1.0) : 1.0; }
  double fraction() const { return fraction_; }
  void finer() { set_fraction(fraction_ * kStep); }
  void coarser() { set_fraction(fraction_ / kStep); }

  /// N for this asset: the fraction, within what has arrived; 0 before the base level has.
  std::uint32_t vertices(const Asset& asset) const {
    const bool drawable = asset.rows_ready > 0 && asset.rows_ready >= asset.base_count;
    return drawable ? level_from_fraction(asset, fraction_) : 0;
  }

 private:
  double fraction_ = 1;
};

/// When the set of received bands changes (docs/protocol.md, section 6) the affected bands go from the values shown to
/// the new ones within kFadeUs of display time. Not thread-safe.
class BandFade {
 public:
  static constexpr TimeUs kFadeUs = 150'000;

  /// Blends `wanted`, a pose of these bands, with the pose `shown` when they changed, both band_ends.back() x channels,
  /// row-major. Nothing fades if they differ in size or band_ends is empty.
  void apply(BandMask bands, TimeUs now_us, std::span<const std::uint32_t> band_ends, std::span<const double> shown,
             Coefficients& wanted);

  bool fading() const { return !fading_.empty(); }
  void reset() { *this = {}; }

 private:
  std::optional<BandMask> shown_bands_;
  BandMask fading_;
  TimeUs started_us_ = 0;
  std::vector<double> from_;  ///< Shown at started_us_.
};

/// Facts of the surface at rest.
struct SurfaceFacts {
  glm::vec3 low{0}, high{0};
  std::vector<glm::vec3> outline;  ///< The points that lie farthest along some directions, in known motion, too.
  Asset::UpAxis up_axis = Asset::UpAxis::kY;
  std::uint64_t version = 0;  ///< Grows when the facts change.
};

struct SceneOptions {
  PlayoutSettings playout;
  double lod = 1;     ///< Upper bound, as a fraction of the vertices.
  bool morph = true;  ///< Whether levels morph (LevelMorph) or jump.
  Shading shading{};
};

/// Turns the poses of a PoseSource into the surface to draw now; of an unchanged pose only new vertices are rebuilt.
/// Keeps the last pose while none comes, even if a new epoch brings the same asset; goes on without a jump where one
/// brings another asset of the same surface (ChangeOver); draws the rest pose before the
/// first one, and as much of an asset as has arrived. Not thread-safe.
class SurfaceView {
 public:
  explicit SurfaceView(const SceneOptions& options = {});

  void receive(const PoseSource& source, const std::vector<ReceivedPose>& poses);

  /// Chooses pose and level. True if anything has changed: then do job() with a SurfaceRebuilder, and call finish().
  /// REQUIRES: no poll() of the source since receive().
  bool prepare(const PoseSource& source, TimeUs now_us);
  RebuildJob job(const Asset& asset);
  void finish(const Asset& asset);
  /// The next rebuild starts afresh: another rebuilder may have done the last one.
  void forget_rebuilt();

  const Reconstructor& reconstructor() const { return *reconstructor_; }
  /// The positions of geometry(), N x 3; rebuilt into `room` if only the GPU has them.
  std::span<const float> positions(std::vector<float>& room) const;

  /// Of all vertices that have arrived, in the pose of geometry(): N x 3, in `room`.
  std::span<const float> whole_positions(std::vector<float>& room) const;
  /// A point within three vertices in the pose of geometry(), whatever the level: their rows' mean by these weights.
  /// REQUIRES: the rows have arrived.
  glm::vec3 point(const std::array<std::uint32_t, 3>& rows, const glm::vec3& weights, std::vector<float>& room) const;

  /// Morphs colours or other values in place: 3 floats a vertex.
  void blend(std::span<float> values) const { morph_.blend(triangles_.map(), values); }
  const LevelMorph& morph() const { return morph_; }
  /// That of blend()'s result.
  std::uint64_t level_version() const { return level_version_; }

  /// REQUIRES: the basis of asset_id(), which is not empty.
  void share(std::shared_ptr<Reconstructor> reconstructor) { reconstructor_ = std::move(reconstructor); }
  const std::shared_ptr<Reconstructor>& shared_reconstructor() const { return reconstructor_; }
  const std::string& asset_id() const { return asset_id_; }

  /// From the next prepare() on.
  void set_shading(const Shading& shading) {
    reshades_ |= shading != shading_;
    shading_ = shading;
  }
  /// An upper bound beside lod().
  void set_max_vertices(std::optional<std::uint32_t> N) { max_vertices_ = N; }
  /// Upper bound of the pixels per surface unit: MorphPace follows it. Infinite (default): unknown.
  void set_px_per_unit(double pixels) { px_per_unit_ = pixels; }
  /// Averages the area, in surface coordinates.
  glm::vec3 barycentre() const;

  const SurfaceGeometry& geometry() const { return geometry_; }
  const SurfaceFacts& facts() const { return facts_; }
  LevelOfDetail& lod() { return lod_; }
  const LevelOfDetail& lod() const { return lod_; }
  /// A source with a timeline() needs none: its poses are shown as they come.
  void set_playout(const PlayoutSettings& settings);
  const Playout& playout() const { return playout_; }
  void set_lag(std::optional<TimeUs> lag_us) { playout_.set_lag(lag_us); }  ///< Playout::set_lag().
  /// kHeld before the first pose.
  Shown shown() const { return shown_; }
  bool settling() const { return settling_; }  ///< See PlayoutPose.
  const std::array<std::uint64_t, 4>& times_shown() const { return times_shown_; }
  /// They rebuild geometry(), r x c row-major, corrections and fades included.
  std::span<const double> coefficients() const { return coefficients_; }
  /// A pause keeps the pose, unless the source has a timeline(); level and asset may change.
  void set_paused(bool paused) { paused_ = paused; }

  /// Does not count the rest pose.
  std::uint64_t poses_shown() const { return poses_shown_; }
  std::uint64_t moves() const { return moves_; }  ///< Poses that were not like the one shown before.
  std::optional<TimeUs> shown_capture_us() const { return shown_time_; }  ///< Capture time of geometry().
  std::optional<TimeUs> newest_arrival_us() const { return newest_arrival_; }
  std::uint32_t bands_received() const { return bands_received_; }
  std::uint64_t poses_unusable() const { return poses_unusable_; }  ///< Wrong size or epoch.

 private:
  void follow_epoch(const PoseSource& source);
  bool change_over(const ChangeOver& change, const Asset& asset);
  void update_barycentre(const Asset& asset);
  void show_rest(const Asset& asset);
  void add_pose(const ReceivedPose& pose, const Asset& asset);
  bool choose_pose(const PoseSource& source, TimeUs now_us);
  bool change_level(const Asset& asset, std::uint32_t N, TimeUs now_us);
  MorphPace pace(const Asset& asset, std::uint32_t N) const;
  void update_facts(const PoseSource& source);
  void include_motion(const PoseSource& source);
  std::vector<float> rest_positions(const Asset& asset) const;
  void part_normals(const Asset& asset);
  void follow_corners();

  Playout playout_;
  PlayoutSettings wanted_playout_;
  LevelOfDetail lod_;
  SurfaceGeometry geometry_;
  SurfaceFacts facts_;
  Shading shading_;
  bool reshades_ = false;
  std::vector<float> creases_;  ///< crease_angles() of the rest pose; empty: unknown.
  std::uint64_t corner_version_ = 0;
  std::uint32_t epoch_ = 0;
  bool has_asset_ = false;
  std::string asset_id_;
  std::shared_ptr<Reconstructor> reconstructor_ = std::make_shared<Reconstructor>();
  std::optional<std::uint32_t> max_vertices_;
  double px_per_unit_ = std::numeric_limits<double>::infinity();
  bool morphs_;
  LevelMorph morph_;
  LevelTriangles triangles_;
  std::uint32_t first_to_rebuild_ = 0, rank_to_rebuild_ = 0;
  std::uint64_t level_version_ = 1;
  bool level_changed_ = false;  ///< Since the last rebuild.
  bool has_detail_ = false;
  std::vector<double> barycentre_weights_;  ///< r: barycentre = weights . coefficients.
  std::uint32_t facts_rows_ = 0;
  BandFade fade_;
  Coefficients coefficients_;  ///< Shown, r x channels_.
  std::uint32_t channels_ = 3;
  BandMask stream_bands_;  ///< For the newest key; steps have none.
  bool has_pose_ = false;  ///< coefficients_ are not the rest pose.
  std::optional<TimeUs> shown_time_, newest_arrival_;
  Shown shown_ = Shown::kHeld;
  bool settling_ = false;
  std::array<std::uint64_t, 4> times_shown_{};
  bool paused_ = false;
  bool is_exact_ = false;  ///< The source has a timeline.
  std::uint64_t poses_shown_ = 0, poses_unusable_ = 0, moves_ = 0;
  std::uint32_t bands_received_ = 0;
};

}  // namespace eigencast
