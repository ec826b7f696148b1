// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <glm/vec2.hpp>
#include <optional>
#include <string>
#include <vector>

#include "view/style.h"

namespace eigencast {

struct HelpLine {
  std::string keys, what, state;
  bool operator==(const HelpLine&) const = default;
};

/// A mark with a text at a place of the picture, in pixels.
struct Label {
  float x_px = 0, y_px = 0;
  std::array<std::uint8_t, 3> colour{};
  std::string text;
  bool is_pin = false;  ///< A ring; else an arrow.
  bool operator==(const Label&) const = default;
};

/// What the overlay shows; leaves out empty strings and lists.
struct OverlayContent {
  std::vector<std::string> figures;  ///< By importance: small pictures leave out the last.
  std::string connection;
  bool connected = true;
  std::string banner;
  std::vector<HelpLine> help;
  bool paused = false;
  std::optional<Legend> legend;
  std::vector<Label> labels;
  float left_px = 0;  ///< Covered by a panel.
  bool operator==(const OverlayContent&) const = default;
};

/// The size of texts and panels, relative to 96 dpi: `layout` in ImGui's units, which are the window's; `pixels` per
/// unit.
struct TextScale {
  float layout = 1, pixels = 1;
  float of_picture() const { return layout * pixels; }  ///< In pixels.
  bool operator==(const TextScale&) const = default;
};

/// Scales texts: on macOS and Wayland the window's units grow with the display's scale `content`; on X11 and Windows
/// the layout must. wanted: instead of the display's; 0: none.
TextScale text_scale(float content, float pixels_per_unit, float wanted = 0);

/// The scale in a window of this size (its units): down to five eighths, so that texts leave room for the scene.
TextScale fitted(TextScale scale, float width, float height);

/// Text over the picture: figures, connection line, banner, help (Dear ImGui). One at a time; the OpenGL context of its
/// creation must be current in every call. Not thread-safe.
class Overlay final {
 public:
  /// window: the GLFWwindow that gives input, or null.
  explicit Overlay(void* window, TextScale scale = {});
  ~Overlay();
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;

  /// panels: draws further ImGui windows.
  void draw(const OverlayContent& content, int width_px, int height_px, unsigned target,
            const std::function<void()>& panels = {});

  /// A button was pressed or released there: panels learn it at once. ImGui looks at the mouse once a picture, when it
  /// may be elsewhere.
  void take_button(glm::vec2 at_px, const OverlayContent& content, const std::function<void()>& panels);

  void set_scale(TextScale scale) { wanted_ = scale; }

  bool wants_mouse() const;
  bool wants_keys() const;
  float scale() const { return scale_.layout; }  ///< See fitted().

 private:
  void use_scale(TextScale scale);
  void begin_frame(int width_px, int height_px, std::optional<glm::vec2> mouse_px = {});
  void lay_out(const OverlayContent& content, const std::function<void()>& panels) const;

  bool has_window_;
  TextScale wanted_;
  TextScale scale_;
};

}  // namespace eigencast
