// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "view/style.h"

namespace eigencast {

/// One line of the help: keys, what they do, how that stands now ("on", "Y", "42 %"; may be empty).
struct HelpLine {
  std::string keys, what, state;
  bool operator==(const HelpLine&) const = default;
};

/// What the overlay shows; empty strings and lists are left out.
struct OverlayContent {
  std::vector<std::string> figures;  ///< The most important first: where there is little room the last are left out.
  std::string connection;
  bool connected = true;
  std::string banner;
  std::vector<HelpLine> help;
  bool paused = false;
  std::optional<Legend> legend;
  float left_px = 0;  ///< What a panel covers.
  bool operator==(const OverlayContent&) const = default;
};

/// How large texts and panels are: `layout` in ImGui's units, which are the window's, as a part of their size at 96
/// dpi; `pixels` of the picture to such a unit.
struct TextScale {
  float layout = 1, pixels = 1;
  float of_picture() const { return layout * pixels; }  ///< Pixels of the picture to one at 96 dpi.
  bool operator==(const TextScale&) const = default;
};

/// For a display that wants everything `content` times as large as at 96 dpi. Where the window's units are larger than
/// pixels (macOS, Wayland) they bring that size along, elsewhere (X11, Windows) the layout must. wanted: instead of the
/// display's; 0: none.
TextScale text_scale(float content, float pixels_per_unit, float wanted = 0);

/// What texts are drawn at in a window of this size (its units): smaller than wanted, down to five eighths, where they
/// would leave the scene too little of it.
TextScale fitted(TextScale scale, float width, float height);

/// Text over the picture: figures, connection line, banner, help (Dear ImGui). One at a time; belongs to the OpenGL
/// context that was current when it was made. Not thread-safe.
class Overlay final {
 public:
  /// `window`: the GLFWwindow whose input it follows, or null without a window.
  explicit Overlay(void* window, TextScale scale = {});
  ~Overlay();
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;

  /// Draws to framebuffer `target`. panels: called while ImGui takes windows, for those that the user operates.
  void draw(const OverlayContent& content, int width_px, int height_px, unsigned target,
            const std::function<void()>& panels = {});

  /// From the next draw() on: the window is on another display.
  void set_scale(TextScale scale) { wanted_ = scale; }

  /// Mouse or keys are the panels' now, not the scene's.
  bool wants_mouse() const;
  bool wants_keys() const;
  float scale() const { return scale_.layout; }  ///< As fitted() to the last picture.

 private:
  void use_scale(TextScale scale);
  void begin_frame(int width_px, int height_px);
  void lay_out(const OverlayContent& content, const std::function<void()>& panels) const;

  bool has_window_;
  TextScale wanted_;
  TextScale scale_;
};

}  // namespace eigencast
