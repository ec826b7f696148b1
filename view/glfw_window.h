// SPDX-License-Identifier: MIT
#pragma once

#include <glm/vec2.hpp>
#include <string>
#include <vector>

#include "common/core/result.h"

struct GLFWwindow;

namespace eigencast {

enum class MouseButton { kLeft, kMiddle, kRight };
struct Modifiers {
  bool shift = false, control = false;
};

/// What happens to a window. Positions are pixels of the picture from its upper left corner.
class WindowListener {
 public:
  virtual ~WindowListener() = default;
  virtual void on_event() = 0;  ///< Before each of the others, and when the picture must be shown again.
  virtual void on_resize(int width_px, int height_px) = 0;
  /// An upper-case letter, another character, or "Home", "Tab", "Escape", "Delete", "F1", "F12".
  virtual void on_key(const std::string& name, const Modifiers& modifiers, bool repeated) = 0;
  virtual void on_wheel(float steps, glm::vec2 at_px) = 0;
  virtual void on_move(glm::vec2) {}
  virtual void on_press(MouseButton, glm::vec2, const Modifiers&) {}
  virtual void on_release(MouseButton) {}
  enum class Drag { kRotate, kPan };
  virtual void on_drag(Drag, glm::vec2 /*by_px*/) {}
  virtual void on_double_click(glm::vec2) {}
  virtual void on_drop(const std::vector<std::string>&) {}
};

/// GLFW's library and one window with an OpenGL 3.3 core context. One at a time, on the main thread; but for its
/// context, which any thread may make current.
class GlfwWindow final {
 public:
  /// instead: what to do without a window, for errors: "--headless writes pictures".
  explicit GlfwWindow(std::string instead) : instead_(std::move(instead)) {}
  ~GlfwWindow();
  GlfwWindow(const GlfwWindow&) = delete;
  GlfwWindow& operator=(const GlfwWindow&) = delete;

  /// Errors: kUnsupported (no display), with what to do instead.
  Result<void> start();
  /// Calls start(). The window stays hidden until listen(). shrink: to what the display has room for. Errors:
  /// kUnsupported (no display, no OpenGL), with what to do instead.
  Result<void> open(int width, int height, const std::string& title, bool shrink = false);
  /// Shows the window and reports events from now on, the size at once. `listener` must outlive the window.
  void listen(WindowListener& listener);

  void make_current() const;        ///< The context is this thread's, which waits for the display in swap().
  static void release_current();    ///< No thread has the context then.
  void poll_events(double wait_s);  ///< Waits for the first at most so long; 0: not at all.
  bool close_wanted() const;        ///< Or lost.
  /// Another program has destroyed it, or the display has gone: it has no size, and nobody sees what it shows.
  bool is_lost() const { return is_lost_; }
  void swap() const;
  void set_title(const std::string& title);
  float content_scale() const;    ///< 1 = 96 dpi
  float pixels_per_unit() const;  ///< The picture's per unit of the window: 2 on some dense displays.
  double display_rate_hz() const;
  glm::ivec2 size() const;     ///< In window units, as it is asked for.
  glm::ivec2 size_px() const;  ///< The picture's.
  std::string clipboard() const;
  void set_clipboard(const std::string& text);
  GLFWwindow* handle() const { return window_; }

 private:
  Error no_window(const std::string& what_to_do) const;
  void report_size();
  void on_cursor(double x, double y);
  void on_button(int button, bool pressed, int modifiers);
  void detect_double_click();
  void detect_loss();
  glm::vec2 pixels(double x, double y) const;

  const std::string instead_;
  bool started_ = false, is_lost_ = false;
  double checked_s_ = 0;
  GLFWwindow* window_ = nullptr;
  WindowListener* listener_ = nullptr;
  glm::vec2 cursor_{0};
  double pressed_s_ = -1;
  glm::vec2 pressed_at_{0};
};

}  // namespace eigencast
