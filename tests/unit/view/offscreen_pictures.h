// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <utility>

#include "view/camera.h"
#include "view/picture.h"
#include "view/renderer.h"
#include "view/scene.h"

namespace eigencast::testing {

/// Pictures drawn without a window.
class OffscreenPictures : public ::testing::Test {
 protected:
  void SetUp() override {
    auto context = OffscreenContext::create();
    ASSERT_TRUE(context) << context.error().message;
    context_ = std::move(context).value();
    auto renderer = Renderer::create();
    ASSERT_TRUE(renderer) << renderer.error().message;
    renderer_ = std::move(renderer).value();
  }
  void frame(const SurfaceFacts& f) { camera_.set_scene(f.low, f.high, f.outline); }

  std::unique_ptr<OffscreenContext> context_;
  std::unique_ptr<Renderer> renderer_;
  Camera camera_;
};

/// A pixel of the surface: everything else in the scene is grey or blue.
inline bool is_clay(const std::uint8_t* pixel) {
  return pixel[0] > pixel[2] + 28;
}

/// Over all channels, of 255; `largest`, if given, grows to the largest of them.
inline double mean_difference(const Picture& a, const Picture& b, int* largest = nullptr) {
  double sum = 0;
  for (std::size_t i = 0; i < a.rgb.size(); ++i) {
    const int difference = std::abs(int{a.rgb[i]} - int{b.rgb[i]});
    sum += difference;
    if (largest != nullptr) *largest = std::max(*largest, difference);
  }
  return sum / static_cast<double>(a.rgb.size());
}

}  // namespace eigencast::testing
