// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/motion/playout.h"
#include "common/reconstruction/level_triangles.h"
#include "common/reconstruction/reconstruct.h"
#include "view/band_fade.h"
#include "view/level_morph.h"
#include "view/level_of_detail.h"
#include "view/pose_source.h"
#include "view/rebuild.h"
#include "view/surface_geometry.h"

namespace eigencast {

/// The rest pose's box, and the ways of the scene that the asset states.
struct SurfaceFacts {
  std::array<float, 3> low{}, high{};
  Asset::UpAxis up_axis = Asset::UpAxis::kY;
  std::uint64_t version = 0;  ///< Grows when the facts change.
};

struct SceneOptions {
  PlayoutSettings playout;
  double lod = 1;     ///< Most of the vertices to draw.
  bool morph = true;  ///< Levels go over into one another (LevelMorph); false: at once.
};

/// One surface of a scene. Turns what a PoseSource found into the surface to draw now: chooses the pose (Playout) and
/// the number of vertices (LevelOfDetail), fades where the set of bands changes (BandFade), lets vertices come and go
/// without a jump (LevelMorph), rebuilds positions and normals; of a pose that stands only the vertices that are new.
/// Keeps the last pose while nothing comes, also when a new epoch brings the same asset; draws the rest pose of an
/// asset before the first pose, and as much of an asset as has arrived.
///
/// Time comes in as arguments. Not thread-safe.
class SurfaceView {
 public:
  explicit SurfaceView(const SceneOptions& options = {});

  /// Takes over what the source's poll() returned.
  void receive(const PoseSource& source, const std::vector<ReceivedPose>& poses);

  /// Rebuilds the surface for `now_us` on the processor if pose, level or asset have changed; true if geometry() has.
  /// REQUIRES: no poll() of the source since receive().
  bool advance(const PoseSource& source, TimeUs now_us);

  /// advance() in its parts, for who rebuilds several surfaces in one pass, or elsewhere: prepare() decides and says
  /// whether anything is to be rebuilt; if so, do job() with a SurfaceRebuilder, then finish(). REQUIRES: as advance().
  bool prepare(const PoseSource& source, TimeUs now_us);
  RebuildJob job(const Asset& asset);
  void finish(const Asset& asset);
  /// The next rebuild takes nothing over from the last one, which another rebuilder may have done.
  void forget_rebuilt();

  const Reconstructor& reconstructor() const { return *reconstructor_; }
  /// The positions of geometry(), N x 3: rebuilt into `room` where only the GPU has them.
  std::span<const float> positions(std::vector<float>& room) const;

  /// What belongs to vertices alone (colours, say) as it is drawn while some of them come or go: 3 floats each of
  /// geometry()'s, in place.
  void blend(std::span<float> values) const { morph_.blend(triangles_.map(), values); }
  const LevelMorph& morph() const { return morph_; }
  /// Grows when blend() gives something else.
  std::uint64_t level_version() const { return level_version_; }

  /// Lets views of the same asset share its basis. REQUIRES: all of them show asset_id(), which is not empty.
  void share(std::shared_ptr<Reconstructor> reconstructor) { reconstructor_ = std::move(reconstructor); }
  const std::shared_ptr<Reconstructor>& shared_reconstructor() const { return reconstructor_; }
  /// Of the asset shown; empty while the source has not named it.
  const std::string& asset_id() const { return asset_id_; }

  /// Draws no more than N vertices from now on, whatever lod() allows; nothing: as many as lod() says.
  void set_max_vertices(std::optional<std::uint32_t> N) { max_vertices_ = N; }
  /// How large it is seen: pixels that one unit of the surface takes at most. Vertices come and go the quicker the
  /// shorter their way is on the screen (MorphPace). Infinite, as at first: not known.
  void set_px_per_unit(double pixels) { px_per_unit_ = pixels; }
  /// The area's barycentre of the pose in geometry(), surface coordinates: a linear function of the coefficients.
  std::array<float, 3> barycentre() const;

  const SurfaceGeometry& geometry() const { return geometry_; }
  const SurfaceFacts& facts() const { return facts_; }
  LevelOfDetail& lod() { return lod_; }
  const LevelOfDetail& lod() const { return lod_; }
  /// Takes effect at the next advance(), without a jump.
  void set_playout(const PlayoutSettings& settings) { playout_.set(settings); }
  const Playout& playout() const { return playout_; }
  /// What geometry() is: see Shown; kHeld before the first pose.
  Shown shown() const { return shown_; }
  bool settling() const { return settling_; }  ///< See ShownPose.
  /// How often each of Shown was drawn anew, in its order.
  const std::array<std::uint64_t, 4>& times_shown() const { return times_shown_; }
  /// The coefficients of geometry(), r x c row-major, corrections and fades included.
  std::span<const double> coefficients() const { return coefficients_; }
  /// While paused the pose stands still; level and asset may still change.
  void set_paused(bool paused) { paused_ = paused; }
  bool paused() const { return paused_; }

  /// Different poses shown so far, the rest pose not counted.
  std::uint64_t poses_shown() const { return poses_shown_; }
  std::optional<TimeUs> shown_capture_us() const { return shown_time_; }  ///< Of the pose in geometry().
  std::optional<TimeUs> newest_arrival_us() const { return newest_arrival_; }
  std::uint32_t bands_received() const { return bands_received_; }
  std::uint64_t poses_unusable() const { return poses_unusable_; }  ///< Their size is not the asset's.

 private:
  void follow_epoch(const PoseSource& source);
  void show_rest(const Asset& asset);
  void add_pose(const ReceivedPose& pose, const Asset& asset);
  bool choose_pose(const PoseSource& source, TimeUs now_us);
  bool change_level(const Asset& asset, std::uint32_t N, TimeUs now_us);
  MorphPace pace(const Asset& asset, std::uint32_t N) const;
  void update_facts(const Asset& asset);

  Playout playout_;
  LevelOfDetail lod_;
  SurfaceGeometry geometry_;
  SurfaceFacts facts_;
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
  bool level_changed_ = false;              ///< Since the last rebuild.
  bool has_detail_ = false;                 ///< Of geometry().
  std::vector<double> barycentre_weights_;  ///< r: barycentre = weights . coefficients.
  std::uint32_t facts_rows_ = 0;
  BandFade fade_;
  std::vector<double> coefficients_;  ///< Shown: r x channels_.
  std::uint32_t channels_ = 3;
  std::uint8_t stream_bands_ = 0;  ///< Of the newest key: steps do not say theirs.
  bool has_pose_ = false;          ///< coefficients_ are of a pose that came, not the rest pose.
  std::optional<TimeUs> shown_time_, newest_arrival_;
  Shown shown_ = Shown::kHeld;
  bool settling_ = false;
  std::array<std::uint64_t, 4> times_shown_{};
  bool paused_ = false;
  std::uint64_t poses_shown_ = 0, poses_unusable_ = 0;
  std::uint32_t bands_received_ = 0;
};

}  // namespace eigencast
