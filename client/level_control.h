// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "client/lod_resolver.h"
#include "view/camera.h"
#include "view/scene.h"

namespace eigencast {

/// Who chooses the levels of detail: the viewer's user alone, our controller, or the paper's.
enum class ResolverKind { kNone, kBudget, kPaper };

/// "none", "budget", "paper": as --resolver names them.
std::string_view name_of(ResolverKind kind);

struct LevelSettings {
  ResolverKind kind = ResolverKind::kNone;
  double target_fps = 60;
  /// When a picture is late, in its times: a display that is missed shows it a whole turn later, a rate that only the
  /// user wants may now and then be missed by a quarter.
  double deadline = 1;
  double floor = 0.02;  ///< Least part of its vertices that a surface keeps.
  /// Of the paper's resolver: distances, scene units, at which G (Eq. 5) is 1 and 0. Default: the eye in the scene's
  /// middle, and four of its radii off.
  std::optional<double> near, far;
};

/// Lets a LodResolver choose the levels of a scene's surfaces: tells it where they are seen, carries its choice out.
///
/// Not thread-safe.
class LevelControl {
 public:
  explicit LevelControl(const LevelSettings& settings);

  /// Sets the levels of the next picture, and how large each surface is seen. `last`: the work of the picture before.
  /// REQUIRES: `sources` are those that the scene advances with.
  void choose(Scene& scene, std::span<PoseSource* const> sources, const Camera& camera, std::optional<FrameWork> last);

  /// Another resolver from the next picture on; the manual level is the upper bound of each.
  void set_kind(ResolverKind kind);
  ResolverKind kind() const { return settings_.kind; }
  const LevelSettings& settings() const { return settings_; }
  /// What the resolver holds; see LodResolver::state(). 0 without one.
  double state() const { return resolver_ ? resolver_->state() : 0; }
  bool active() const { return settings_.kind != ResolverKind::kNone; }

 private:
  void make_resolver(const Camera& camera);

  LevelSettings settings_;
  std::unique_ptr<LodResolver> resolver_;
};

/// What the resolver is to know of a surface: all vertices that may be drawn, distance and size on the screen.
ObjectView object_view(const Scene::Instance& instance, const Asset& asset, const Camera& camera, double floor);

}  // namespace eigencast
