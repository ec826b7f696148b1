// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "view/paint.h"
#include "view/renderer.h"
#include "view/scene.h"
#include "view/style.h"

namespace eigencast {

/// Paints a scene's surfaces, and keeps their common legend. Not thread-safe.
class SceneColours final {
 public:
  explicit SceneColours(Decode decode = Decode::kBackground) : decode_(decode) {}

  /// Takes what the surfaces show now. max_texture_side: the GPU's limit. REQUIRES: `sources` are those that the scene
  /// advances with.
  void update(const Scene& scene, std::span<PoseSource* const> sources, const Style& style,
              int max_texture_side = kMaxTextureSide);
  /// Gives the renderer what update() took.
  void upload(Renderer& renderer) const;
  /// Later surfaces move up.
  void remove(std::size_t surface);

  std::array<float, 2> range(const Style& style) const;
  /// Nothing while colours show no numbers. asset: the first surface's, for its units; may be null.
  std::optional<Legend> legend(const Asset* asset) const;
  /// Why the first surface's colours are not as asked for; empty if they are.
  std::string why_not() const { return painters_.empty() ? std::string() : painters_.front().why_not(); }
  bool is_waiting() const;

 private:
  /// Of the first surface; null where its stream does not say.
  const ScalarChannel* scalar() const { return painters_.empty() ? nullptr : painters_.front().scalar(); }

  Decode decode_;
  std::vector<SurfacePainter> painters_;  ///< One for each surface.
  LegendRange range_;
  Style painted_;
};

std::vector<SurfacePainter::Wish> colourings_of(std::span<PoseSource* const> sources);
SurfacePainter::Wish next_colouring(std::span<PoseSource* const> sources, const SurfacePainter::Wish& wish);

}  // namespace eigencast
