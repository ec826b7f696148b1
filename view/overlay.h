// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "view/look.h"

namespace eigencast {

/// One line of the help: keys, what they do, how that stands now ("on", "Y", "42 %"; may be empty).
struct HelpLine {
  std::string keys, what, state;
};

/// What the overlay shows; empty strings and lists are left out.
struct OverlayContent {
  std::vector<std::string> figures;
  std::string connection;
  bool connected = true;
  std::string banner;
  std::vector<HelpLine> help;
  bool paused = false;
  std::optional<Legend> legend;
};

/// Text over the picture: figures, connection line, banner, help (Dear ImGui). One at a time; belongs to the OpenGL
/// context that was current when it was made. Not thread-safe.
class Overlay final {
 public:
  /// `window`: the GLFWwindow whose input it follows, or null without a window. scale: 1 = 96 dpi.
  explicit Overlay(void* window, float scale = 1);
  ~Overlay();
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;

  /// Draws to framebuffer `target`.
  void draw(const OverlayContent& content, int width_px, int height_px, unsigned target);

 private:
  bool has_window_;
  float scale_;
};

}  // namespace eigencast
