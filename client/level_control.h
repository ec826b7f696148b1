// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "common/core/text.h"
#include "common/levels/lod_resolver.h"
#include "view/camera.h"
#include "view/scene.h"

namespace eigencast {

/// What chooses the levels of detail: the user alone, our controller, or the paper's.
enum class ResolverKind { kNone, kBudget, kPaper };

inline constexpr EnumNames<ResolverKind, 3> kResolverNames{{"none", "budget", "paper"}};

struct LevelSettings {
  ResolverKind kind = ResolverKind::kNone;
  double target_fps = 60;
  /// In times of 1 / target_fps: 1 for a display, where a late picture waits for the next refresh; 1.25 without one.
  double deadline = 1;
  double floor = 0.02;  ///< Smallest part of its vertices that a surface keeps.
  /// For kPaper: distances at which G (Eq. 5) is 1 and 0. Default: 0, and four radii of the scene.
  std::optional<double> near, far;
};

/// Lets a LodResolver choose the levels of a scene's surfaces. Not thread-safe.
class LevelControl {
 public:
  explicit LevelControl(const LevelSettings& settings);

  /// Sets levels and sizes on the screen for the next picture. last: the work of the last one.
  /// REQUIRES: `sources` are those that the scene advances with.
  void choose(Scene& scene, std::span<PoseSource* const> sources, const Camera& camera, std::optional<FrameWork> last);

  void set_kind(ResolverKind kind);
  ResolverKind kind() const { return settings_.kind; }
  const LevelSettings& settings() const { return settings_; }
  double state() const { return resolver_ ? resolver_->state() : 0; }
  bool active() const { return settings_.kind != ResolverKind::kNone; }

 private:
  void make_resolver(const Camera& camera);

  LevelSettings settings_;
  std::unique_ptr<LodResolver> resolver_;
};

ObjectView object_view(const Scene::Instance& instance, const Asset& asset, const Camera& camera, double floor);

}  // namespace eigencast
