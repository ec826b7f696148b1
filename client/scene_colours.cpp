// SPDX-License-Identifier: MIT
#include "client/scene_colours.h"

#include <algorithm>

namespace eigencast {

void SceneColours::update(const Scene& scene, std::span<PoseSource* const> sources, const Style& style,
                          int max_texture_side) {
  const auto& instances = scene.instances();
  painters_.resize(instances.size());
  if (!(style.colour == painted_.colour)) range_.reset();
  painted_ = style;
  for (std::size_t i = 0; i < instances.size(); ++i) {
    painters_[i].set_images(decode_, max_texture_side);
    painters_[i].paint(instances[i].view, *sources[instances[i].placement.source], style.colour);
    if (painters_[i].range()) range_.include(*painters_[i].range());
  }
}

void SceneColours::upload(Renderer& renderer) const {
  for (std::size_t i = 0; i < painters_.size(); ++i) renderer.paint(i, painters_[i].paint());
}

bool SceneColours::is_waiting() const {
  return std::any_of(painters_.begin(), painters_.end(), [](const auto& painter) { return painter.is_waiting(); });
}

void SceneColours::remove(std::size_t surface) {
  if (surface < painters_.size()) painters_.erase(painters_.begin() + static_cast<std::ptrdiff_t>(surface));
}

std::array<float, 2> SceneColours::range(const Style& style) const {
  if (style.colour_range || scalar() == nullptr || !(scalar()->low < scalar()->high))
    return style.colour_range.value_or(range_.span());
  return {static_cast<float>(scalar()->low), static_cast<float>(scalar()->high)};
}

std::optional<Legend> SceneColours::legend(const Asset* asset) const {
  if (!range_.known()) return std::nullopt;
  const double metres_per_unit = asset == nullptr ? 0 : asset->metres_per_unit;
  const auto span = range(painted_);
  Legend legend{title_of(painted_.colour), unit_of(painted_.colour, metres_per_unit), span[0], span[1],
                painted_.colour_map};
  if (!legend.unit.empty() && metres_per_unit > 0) {
    legend.low *= static_cast<float>(metres_per_unit);
    legend.high *= static_cast<float>(metres_per_unit);
  }
  if (scalar() != nullptr) legend.unit = scalar()->unit;
  return legend;
}

std::vector<SurfacePainter::Wish> colourings_of(std::span<PoseSource* const> sources) {
  std::vector<SurfacePainter::Wish> all;
  for (const PoseSource* source : sources) {
    for (const SurfacePainter::Wish& offered : wishes_for(*source)) {
      if (std::find(all.begin(), all.end(), offered) == all.end()) all.push_back(offered);
    }
  }
  return all;
}

SurfacePainter::Wish next_colouring(std::span<PoseSource* const> sources, const SurfacePainter::Wish& wish) {
  const std::vector<SurfacePainter::Wish> all = colourings_of(sources);
  const auto at = std::find(all.begin(), all.end(), wish);
  return at == all.end() || at + 1 == all.end() ? SurfacePainter::Wish{} : *(at + 1);
}

}  // namespace eigencast
