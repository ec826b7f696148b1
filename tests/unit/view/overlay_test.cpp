// SPDX-License-Identifier: MIT
#include "view/overlay.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <tuple>

#include "tests/unit/view/offscreen_pictures.h"

namespace eigencast {
namespace {

TEST(TextScales, FollowTheDisplayInWhateverUnits) {
  EXPECT_EQ(text_scale(1, 1), (TextScale{1, 1}));
  EXPECT_EQ(text_scale(2, 1), (TextScale{2, 1})) << "X11, Windows: units are pixels";
  EXPECT_EQ(text_scale(2, 2), (TextScale{1, 2})) << "macOS, Wayland: units are two pixels, letters still sharp";
  EXPECT_EQ(text_scale(1.5F, 2), (TextScale{1, 2})) << "never smaller than at 96 dpi";
  EXPECT_EQ(text_scale(3, 1.5F), (TextScale{2, 1.5F}));
  EXPECT_EQ(text_scale(2, 2, 3), (TextScale{3, 2})) << "--ui-scale wins";
}

TEST(TextScales, ShrinkInSmallWindows) {
  EXPECT_EQ(fitted({1, 1}, 640, 480), (TextScale{1, 1}));
  EXPECT_EQ(fitted({2, 1}, 1280, 720), (TextScale{2, 1}));
  EXPECT_EQ(fitted({2, 1}, 480, 360), (TextScale{1.25F, 1})) << "five eighths at most";
  EXPECT_EQ(fitted({1, 2}, 300, 400), (TextScale{0.875F, 2})) << "in the window's units";
  EXPECT_EQ(fitted({4, 1}, 30, 20), (TextScale{2.5F, 1})) << "five eighths at least";
}

/// All that a viewer may say at once.
OverlayContent all_texts() {
  OverlayContent content;
  for (const char* line :
       {"30 keys/s \xC2\xB7 90 poses/s \xC2\xB7 60 drawn/s", "56 kbit/s \xC2\xB7 latency 4.1 ms (p99 38 ms)",
        "LOD 0.42 \xC2\xB7 13,777 of 32,802 vertices, 27,550 faces", "interpolated x3 hermite full",
        "interpolated, going over \xC2\xB7 67 ms held back (smooth 100 %)",
        "budget \xC2\xB7 60/s \xC2\xB7 12.1 of 16.7 ms \xC2\xB7 87 % planned",
        "bands 3 of 4 \xC2\xB7 rank 200 \xC2\xB7 rebuilt on the GPU", "of each 1.00 0.42 0.07 0.33 0.25"})
    content.figures.emplace_back(line);
  content.connection = "lost \xC2\xB7 demo \xC2\xB7 the broker at 127.0.0.1 does not answer; next try in 400 ms";
  content.connected = false;
  content.banner = "no data for 3.2 s - connection lost: the broker at 127.0.0.1 does not answer; next try in 400 ms";
  content.legend = Legend{"movement from rest", "m", 0, 0.4F, ColourMap::kViridis};
  content.paused = true;
  return content;
}

/// Where two pictures differ.
struct Changed {
  int pixels = 0, at_the_edge = 0, lowest = 0, leftmost = std::numeric_limits<int>::max();
};

Changed changed_between(const Picture& a, const Picture& b) {
  constexpr int kEdge = 5;
  Changed changed;
  for (int y = 0; y < a.height; ++y) {
    for (int x = 0; x < a.width; ++x) {
      if (std::equal(a.pixel(x, y), a.pixel(x, y) + 3, b.pixel(x, y))) continue;
      ++changed.pixels;
      changed.lowest = y;
      changed.leftmost = std::min(changed.leftmost, x);
      if (x < kEdge || y < kEdge || x >= a.width - kEdge || y >= a.height - kEdge) ++changed.at_the_edge;
    }
  }
  return changed;
}

using Overlays = testing::OffscreenPictures;

TEST_F(Overlays, TextsLeaveTheSurfaceItsPart) {
  const OverlayContent all = all_texts();
  for (const auto& [width, height, scale] :
       {std::tuple(480, 360, 2.0F), std::tuple(1280, 720, 1.0F), std::tuple(320, 240, 1.0F), std::tuple(300, 300, 1.0F),
        std::tuple(900, 320, 3.0F)}) {
    SCOPED_TRACE(std::to_string(width) + " x " + std::to_string(height));
    Overlay overlay(nullptr, text_scale(1, 1, scale));
    camera_.set_viewport(320, 240);
    camera_.set_view("front");
    const auto drawn = [&, width = width, height = height](const OverlayContent& content) {
      const unsigned target = renderer_->offscreen_target(width, height);
      renderer_->draw(camera_, {}, width, height, target);
      overlay.draw(content, width, height, target);
      return Renderer::read_back(width, height, target);
    };
    const Picture plain = drawn({});
    const double pixels = static_cast<double>(width) * height;
    const Changed everything = changed_between(plain, drawn(all));
    EXPECT_EQ(everything.at_the_edge, 0) << "nothing is cut off";
    EXPECT_LT(everything.pixels, 0.75 * pixels);
    OverlayContent figures;
    figures.figures = all.figures;
    const Picture first = drawn(figures);
    const Changed upper = changed_between(plain, first);
    EXPECT_GT(upper.pixels, 0.02 * pixels) << "there in the first picture";
    EXPECT_LE(upper.lowest, 0.4 * height);
    // Whatever there is room for, the last goes first.
    figures.figures.back() = "of each 0.99";
    const bool has_room = width == 1280;
    EXPECT_EQ(changed_between(first, drawn(figures)).pixels > 0, has_room);
    figures.figures.front() = "29 keys/s";
    EXPECT_GT(changed_between(first, drawn(figures)).pixels, 0);
    OverlayContent help;
    help.help = std::vector<HelpLine>(
        27, {"right or middle drag, Shift+left", "turn round the point that was hit", "as they come"});
    const Changed helped = changed_between(plain, drawn(help));
    EXPECT_EQ(helped.at_the_edge, 0);
    EXPECT_GT(helped.pixels, 0.1 * pixels);
    help.left_px = 0.3F * static_cast<float>(width);
    const Changed beside = changed_between(plain, drawn(help));
    if (width >= 480) {
      EXPECT_GE(beside.leftmost, 0.3 * width) << "a panel covers none of its keys";
    }
    EXPECT_EQ(beside.at_the_edge, 0);
  }
}

}  // namespace
}  // namespace eigencast
