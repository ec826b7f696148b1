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

/// One surface of a scene, before anything has come: which stream it shows and where it stands.
struct Placement {
  std::size_t source = 0;  ///< Number of its stream; several surfaces may show one.
  std::string name;        ///< For people; empty: the stream's.
  glm::mat4 scene_from_world{1};
};

/// The surfaces to draw, each from one of several streams. Chooses poses and levels (SurfaceView), and lets a
/// SurfaceRebuilder rebuild what has changed in one go.
///
/// A stream's own world transform (docs/protocol.md) comes first, the placement's after it. Time comes in as arguments.
/// Not thread-safe.
class Scene {
 public:
  struct Instance {
    Placement placement;
    SurfaceView view;
    glm::mat4 scene_from_surface{1};
    bool visible = true;
  };

  /// row: place surfaces whose stream states no world beside one another, along the scene's first axis; more than six
  /// in several rows, one behind the other.
  Scene(std::vector<Placement> placements, const SceneOptions& options, bool row = false);

  /// One surface more, after those there are.
  void add(Placement placement);
  /// Takes surface number `index` out; later ones move up. REQUIRES: there is one.
  void remove(std::size_t index);

  /// Takes over what poll() of stream number `index` returned.
  void receive(std::size_t index, const PoseSource& source, const std::vector<ReceivedPose>& poses);

  /// Who rebuilds from now on, which must outlive the scene's last advance(); at first, and with null, the processor.
  void set_rebuilder(SurfaceRebuilder* rebuilder);
  SurfaceRebuilder& rebuilder() { return rebuilder_ != nullptr ? *rebuilder_ : cpu_; }

  /// Rebuilds for `now_us` what has changed; true if anything has. REQUIRES: no poll() since receive().
  bool advance(std::span<PoseSource* const> sources, TimeUs now_us);

  std::vector<Instance>& instances() { return instances_; }
  const std::vector<Instance>& instances() const { return instances_; }
  /// Most of the vertices that any surface draws.
  LevelOfDetail& lod() { return lod_; }
  const LevelOfDetail& lod() const { return lod_; }
  void set_paused(bool paused);
  void set_playout(const PlayoutSettings& settings);

  /// The box around the rest poses of all surfaces, in the scene; its version is 0 before there is one, and grows when
  /// it changes.
  const SurfaceFacts& facts() const { return facts_; }
  /// Different poses shown by the surface that has shown most.
  std::uint64_t poses_shown() const;

  std::uint64_t vertex_count() const;                                  ///< Drawn, of all surfaces.
  std::uint64_t triangle_count() const;                                ///< Likewise.
  const Histogram& reconstruct_us() const { return reconstruct_us_; }  ///< Of all surfaces together, each advance().
  const Histogram& normals_us() const { return normals_us_; }          ///< Likewise.

 private:
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

/// The middle of a surface's pose and its radius, in the scene, and how much larger it is there than in itself.
struct Extent {
  glm::vec3 barycentre{0};
  float radius = 0;
  float scale = 1;
};
Extent extent_of(const Scene::Instance& instance);

}  // namespace eigencast
