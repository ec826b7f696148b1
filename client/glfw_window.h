// SPDX-License-Identifier: MIT
#pragma once

#include <glm/vec2.hpp>
#include <string>
#include <vector>

#include "common/core/result.h"

struct GLFWwindow;

namespace eigencast {

/// What happens to a window. Places are pixels of the picture from its upper left corner.
class WindowListener {
 public:
  virtual ~WindowListener() = default;
  virtual void on_resize(int width_px, int height_px) = 0;
  virtual void on_anything() = 0;  ///< Before each of the others, and when the picture must be shown again.
  /// "A", "Ctrl+C", "Shift+S", "Home": see action_for_key.
  virtual void on_key(const std::string& name, bool repeated) = 0;
  enum class Drag { kRotate, kPan };
  virtual void on_drag(Drag drag, glm::vec2 by_px) = 0;
  virtual void on_wheel(float steps, glm::vec2 at_px) = 0;
  virtual void on_double_click(glm::vec2 at_px) = 0;
  virtual void on_drop(const std::vector<std::string>& what) = 0;
};

/// GLFW's library and one window with an OpenGL 3.3 core context, current from open() on. One at a time, on the main
/// thread.
class GlfwWindow final {
 public:
  GlfwWindow() = default;
  ~GlfwWindow();
  GlfwWindow(const GlfwWindow&) = delete;
  GlfwWindow& operator=(const GlfwWindow&) = delete;

  /// shrink: to what the display has room for. Errors: kUnsupported (no display, no OpenGL), with what to do instead.
  Result<void> open(int width, int height, const std::string& title, bool shrink);
  /// From now on, when the window is shown; `listener` must outlive the window. It is told the size at once.
  void listen(WindowListener& listener);

  void poll_events(double wait_s);  ///< Waits for the first at most so long; 0: not at all.
  bool close_wanted() const;
  void swap();
  void set_title(const std::string& title);
  float content_scale() const;    ///< 1 = 96 dpi
  float pixels_per_unit() const;  ///< Of the picture, to a unit of the window: 2 on dense displays of some systems.
  double display_rate_hz() const;
  glm::ivec2 size() const;  ///< In window units, as it is asked for.
  std::string clipboard() const;
  void set_clipboard(const std::string& text);
  GLFWwindow* handle() const { return window_; }

 private:
  void take_size();
  void on_cursor(double x, double y);
  void on_press();
  glm::vec2 pixels(double x, double y) const;

  bool library_ = false;
  GLFWwindow* window_ = nullptr;
  WindowListener* listener_ = nullptr;
  glm::vec2 cursor_{0};
  double pressed_s_ = -1;
  glm::vec2 pressed_at_{0};
};

}  // namespace eigencast
