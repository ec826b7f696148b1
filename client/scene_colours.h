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

/// The colours of a scene's surfaces: paints them as a style asks for, and keeps the legend of all together.
///
/// Not thread-safe.
class SceneColours final {
 public:
  /// decode: who decodes the surfaces' images.
  explicit SceneColours(Decode decode = Decode::kBackground) : decode_(decode) {}

  /// Paints what the surfaces are now, and hands it to the renderer. REQUIRES: `sources` are those that the scene
  /// advances with.
  void paint(const Scene& scene, std::span<PoseSource* const> sources, const Style& style, Renderer& renderer);
  /// Surface number `surface` has gone; later ones move up.
  void remove(std::size_t surface);

  /// The values of the colour map's ends for this style.
  std::array<float, 2> range(const Style& style) const { return style.colour_range.value_or(range_.span()); }
  /// Of what was painted last; nothing while colours stand for no numbers. asset: the first surface's, for its units;
  /// may be null.
  std::optional<Legend> legend(const Asset* asset) const;
  /// Why the first surface's colours are not those that the style asks for; empty if they are.
  std::string why_not() const { return painters_.empty() ? std::string() : painters_.front().why_not(); }
  /// Something is being made for them: paint again soon.
  bool is_waiting() const;

 private:
  Decode decode_;
  std::vector<SurfacePainter> painters_;  ///< One for each surface.
  LegendRange range_;
  Style painted_;
};

/// All that streams offer, and the one after this.
std::vector<SurfacePainter::Wish> colourings_of(std::span<PoseSource* const> sources);
SurfacePainter::Wish next_colouring(std::span<PoseSource* const> sources, const SurfacePainter::Wish& wish);

}  // namespace eigencast
