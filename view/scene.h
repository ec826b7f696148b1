// SPDX-License-Identifier: MIT
#pragma once

#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/core/histogram.h"
#include "view/surface_view.h"

namespace eigencast {

struct Placement {
  std::size_t source = 0;  ///< Index of the stream; several surfaces may show one.
  std::string name;        ///< For people; default: the stream's.
  glm::mat4 scene_from_world{1};
};

/// Surfaces, each from one of several streams; all that have changed are rebuilt in one call. A stream's world
/// transform (docs/protocol.md) is applied before the placement's. Not thread-safe.
class Scene {
 public:
  struct Instance {
    Placement placement;
    SurfaceView view;
    glm::mat4 scene_from_surface{1};
    bool visible = true;
  };

  /// row: surfaces whose stream states no world form rows along the scene's first axis, one up to six surfaces.
  Scene(std::vector<Placement> placements, const SceneOptions& options, bool row = false);

  void add(Placement placement);
  /// Later surfaces move up. REQUIRES: index < instances().size().
  void remove(std::size_t index);

  void receive(std::size_t index, const PoseSource& source, const std::vector<ReceivedPose>& poses);

  /// Null (default): the processor. The rebuilder must outlive the last advance().
  void set_rebuilder(SurfaceRebuilder* rebuilder);
  SurfaceRebuilder& rebuilder() { return rebuilder_ != nullptr ? *rebuilder_ : cpu_; }

  /// Rebuilds what has changed; true if anything has. REQUIRES: no poll() since receive().
  bool advance(std::span<PoseSource* const> sources, TimeUs now_us);

  std::vector<Instance>& instances() { return instances_; }
  const std::vector<Instance>& instances() const { return instances_; }
  LevelOfDetail& lod() { return lod_; }
  const LevelOfDetail& lod() const { return lod_; }
  void set_paused(bool paused) {
    for (Instance& instance : instances_) instance.view.set_paused(paused);
  }
  void set_playout(const PlayoutSettings& settings);
  void set_shading(const Shading& shading) { options_.shading = shading; }

  /// The box around all rest poses, in the scene. Version 0: none yet.
  const SurfaceFacts& facts() const { return facts_; }
  std::uint64_t poses_shown() const;
  std::uint64_t moves() const;  ///< Of all surfaces: see SurfaceView::moves().

  std::uint64_t vertex_count() const;                                  ///< Drawn, of all surfaces.
  std::uint64_t triangle_count() const;                                ///< Likewise.
  const Histogram& reconstruct_us() const { return reconstruct_us_; }  ///< Per advance(), all surfaces.
  const Histogram& normals_us() const { return normals_us_; }          ///< Likewise.

 private:
  void keep_together(std::span<PoseSource* const> sources);
  void share_basis(SurfaceView& view);
  void place(std::span<PoseSource* const> sources);

  SceneOptions options_;
  std::vector<Instance> instances_;
  LevelOfDetail lod_;
  bool row_;
  CpuRebuilder cpu_;
  SurfaceRebuilder* rebuilder_ = nullptr;                      ///< Instead of cpu_.
  std::map<std::string, std::weak_ptr<Reconstructor>> bases_;  ///< By asset.
  SurfaceFacts facts_;
  std::uint64_t facts_seen_ = 0;
  Histogram reconstruct_us_, normals_us_;
};

/// Centre and radius of a surface's pose in the scene; scale: from surface to scene.
struct Extent {
  glm::vec3 barycentre{0};
  float radius = 0;
  float scale = 1;
};
Extent extent_of(const Scene::Instance& instance);

}  // namespace eigencast
