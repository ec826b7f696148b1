// SPDX-License-Identifier: MIT
#pragma once

#include <glm/ext/matrix_transform.hpp>
#include <memory>
#include <vector>

#include "tests/unit/view/fake_source.h"
#include "view/scene.h"

namespace eigencast::testing {

/// A scene fed by hand: stream i shows what sources[i] is given.
struct Stage {
  explicit Stage(std::vector<Asset> assets, std::vector<Placement> placements, bool row = false)
      : scene(std::move(placements), {}, row) {
    for (Asset& asset : assets) {
      sources.push_back(std::make_unique<FakeSource>(std::move(asset)));
      sources.back()->info_->epoch = 1;
      list.push_back(sources.back().get());
    }
  }
  bool turn(TimeUs now_us) {
    for (std::size_t i = 0; i < list.size(); ++i) scene.receive(i, *list[i], list[i]->poll({}));
    return scene.advance(list, now_us);
  }
  const SurfaceGeometry& geometry(std::size_t i) const { return scene.instances()[i].view.geometry(); }

  std::vector<std::unique_ptr<FakeSource>> sources;
  std::vector<PoseSource*> list;
  Scene scene;
};

inline Placement at(std::size_t source, const glm::vec3& position) {
  return {source, "", glm::translate(glm::mat4(1), position)};
}

}  // namespace eigencast::testing
