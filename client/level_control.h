// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "common/core/text.h"
#include "common/levels/lod_resolver.h"
#include "common/levels/quality_control.h"
#include "view/camera.h"
#include "view/scene.h"
#include "view/style.h"

namespace eigencast {

/// What chooses the levels of detail: the user alone, our controller, or the paper's.
enum class ResolverKind { kNone, kBudget, kPaper };

inline constexpr EnumNames<ResolverKind, 3> kResolverNames{{"none", "budget", "paper"}};

/// How pictures are drawn: what is least seen goes first (kBudget only), all of it, or as quickly as can be.
enum class QualityMode { kAuto, kFull, kLow };

inline constexpr EnumNames<QualityMode, 3> kQualityNames{{"auto", "full", "low"}};
inline constexpr EnumNames<ShadowQuality, 3> kShadowNames{{"full", "small", "none"}};

struct LevelSettings {
  QualityMode quality = QualityMode::kFull;
  ResolverKind kind = ResolverKind::kNone;
  double target_fps = 60;
  double least_fps = 0;  ///< See QualityControl::Settings::least_f0.
  /// In times of 1 / target_fps: 1 for a display, where a late picture waits for the next refresh; 1.25 without one.
  double deadline = 1;
  double floor = 0.02;  ///< Smallest part of its vertices that a surface keeps.
  /// For kPaper: distances at which G (Eq. 5) is 1 and 0. Default: 0, and four radii of the scene.
  std::optional<double> near, far;
};

/// Lets a QualityControl choose the levels of a scene's surfaces, and how pictures are drawn, or the paper's resolver.
/// Not thread-safe.
class LevelControl {
 public:
  explicit LevelControl(const LevelSettings& settings);

  /// Sets levels and sizes on the screen for the next picture. last: the work of the last one.
  /// REQUIRES: `sources` are those that the scene advances with.
  void choose(Scene& scene, std::span<PoseSource* const> sources, const Camera& camera, std::optional<FrameWork> last);

  /// For the next picture.
  const PictureQuality& quality() const { return quality_; }
  /// What to draw beside the next picture, once, and what that gave; see QualityControl::trial().
  std::optional<PictureQuality> trial();
  void measured(double own, double other, double error);

  /// A still picture has time: it gets all. True if that changes it.
  bool set_still(bool still);

  void set_kind(ResolverKind kind);
  ResolverKind kind() const { return settings_.kind; }
  const LevelSettings& settings() const { return settings_; }
  double state() const { return control_ ? control_->state() : resolver_ ? resolver_->state() : 0; }
  double target_fps() const { return control_ ? control_->f0() : settings_.target_fps; }
  bool active() const { return settings_.kind != ResolverKind::kNone; }
  /// Something is missing from the next picture.
  bool lowered() const { return active() && !still_ && lowered_; }

 private:
  void make_resolver(const Camera& camera);
  bool has_resolver() const { return resolver_ != nullptr || control_; }
  std::vector<std::uint32_t> resolve(std::span<const ObjectView> objects, std::optional<FrameWork> last);

  LevelSettings settings_;
  PictureQuality quality_;
  std::optional<QualityControl> control_;  ///< Instead of resolver_.
  std::vector<std::size_t> steps_;         ///< Of its knobs.
  std::optional<std::size_t> tried_;       ///< The knob of the last trial().
  bool still_ = false, was_still_ = false, lowered_ = false;
  std::unique_ptr<LodResolver> resolver_;
};

/// Without gains.
ObjectView object_view(const Scene::Instance& instance, const Asset& asset, const Camera& camera, double floor);

}  // namespace eigencast
