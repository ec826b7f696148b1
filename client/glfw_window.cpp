// SPDX-License-Identifier: MIT
#define GLFW_INCLUDE_NONE
#include "client/glfw_window.h"

#include <GLFW/glfw3.h>

#include <algorithm>
#include <glm/geometric.hpp>

namespace eigencast {
namespace {

constexpr double kDoubleClickS = 0.35;
constexpr float kDoubleClickPx = 6;  // at 96 dpi

std::string base_name_of(int key) {
  if ((key >= GLFW_KEY_A && key <= GLFW_KEY_Z) || key == GLFW_KEY_SPACE || key == GLFW_KEY_COMMA ||
      key == GLFW_KEY_PERIOD || key == GLFW_KEY_LEFT_BRACKET || key == GLFW_KEY_RIGHT_BRACKET ||
      key == GLFW_KEY_MINUS || key == GLFW_KEY_EQUAL) {
    return std::string(1, static_cast<char>(key));
  }
  switch (key) {
    case GLFW_KEY_KP_ADD:
      return "+";
    case GLFW_KEY_KP_SUBTRACT:
      return "-";
    case GLFW_KEY_HOME:
      return "Home";
    case GLFW_KEY_TAB:
      return "Tab";
    case GLFW_KEY_F1:
      return "F1";
    case GLFW_KEY_F12:
      return "F12";
    case GLFW_KEY_ESCAPE:
      return "Escape";
    default:
      return {};
  }
}

std::string name_of_key(int key, int modifiers) {
  const std::string name = base_name_of(key);
  if (name.empty()) return name;
  if ((modifiers & GLFW_MOD_CONTROL) != 0) return "Ctrl+" + name;
  // Elsewhere Shift is how some keyboards reach a sign.
  return (modifiers & GLFW_MOD_SHIFT) != 0 && (name == "S" || name == "F12") ? "Shift+" + name : name;
}

Error no_window(const char* what_to_do) {
  const char* why = nullptr;
  glfwGetError(&why);
  return fail(ErrorCode::kUnsupported, std::string("no window can be opened: ") +
                                           (why != nullptr ? why : "unknown reason") + ". " + what_to_do +
                                           ", --headless --frames 90 --out DIR writes pictures instead");
}

GlfwWindow& of(GLFWwindow* window) {
  return *static_cast<GlfwWindow*>(glfwGetWindowUserPointer(window));
}

}  // namespace

GlfwWindow::~GlfwWindow() {
  if (window_ != nullptr) glfwDestroyWindow(window_);
  if (library_) glfwTerminate();
}

Result<void> GlfwWindow::open(int width, int height, const std::string& title, bool shrink) {
  glfwSetErrorCallback(nullptr);
  if (glfwInit() != GLFW_TRUE) return no_window("Without a display");
  library_ = true;
  if (GLFWmonitor* monitor = glfwGetPrimaryMonitor(); shrink && monitor != nullptr) {
    int room_w = 0, room_h = 0;
    glfwGetMonitorWorkarea(monitor, nullptr, nullptr, &room_w, &room_h);
    if (room_w > 0 && room_h > 0) width = std::min(width, room_w), height = std::min(height, room_h);
  }
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
  glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
  glfwWindowHint(GLFW_VISIBLE, GLFW_FALSE);
  window_ = glfwCreateWindow(width, height, title.c_str(), nullptr, nullptr);
  if (window_ == nullptr) {
    return no_window(
        "The display must offer OpenGL 3.3: install its graphics driver (Debian: libgl1-mesa-dri); without one");
  }
  glfwMakeContextCurrent(window_);
  glfwSwapInterval(1);
  return {};
}

void GlfwWindow::listen(WindowListener& listener) {
  listener_ = &listener;
  glfwSetWindowUserPointer(window_, this);
  glfwSetFramebufferSizeCallback(window_, [](GLFWwindow* w, int, int) { of(w).take_size(); });
  glfwSetWindowContentScaleCallback(window_, [](GLFWwindow* w, float, float) { of(w).take_size(); });
  glfwSetWindowRefreshCallback(window_, [](GLFWwindow* w) { of(w).listener_->on_anything(); });
  glfwSetWindowFocusCallback(window_, [](GLFWwindow* w, int) { of(w).listener_->on_anything(); });
  glfwSetCharCallback(window_, [](GLFWwindow* w, unsigned) { of(w).listener_->on_anything(); });
  glfwSetKeyCallback(window_, [](GLFWwindow* w, int key, int, int action, int modifiers) {
    of(w).listener_->on_anything();
    const std::string name = name_of_key(key, modifiers);
    if (action != GLFW_RELEASE && !name.empty()) of(w).listener_->on_key(name, action == GLFW_REPEAT);
  });
  glfwSetMouseButtonCallback(window_, [](GLFWwindow* w, int button, int action, int) {
    of(w).listener_->on_anything();
    if (button == GLFW_MOUSE_BUTTON_LEFT && action == GLFW_PRESS) of(w).on_press();
  });
  glfwSetCursorPosCallback(window_, [](GLFWwindow* w, double x, double y) { of(w).on_cursor(x, y); });
  glfwSetScrollCallback(window_, [](GLFWwindow* w, double, double steps) {
    of(w).listener_->on_anything();
    of(w).listener_->on_wheel(static_cast<float>(steps), of(w).cursor_);
  });
  glfwSetDropCallback(window_, [](GLFWwindow* w, int count, const char** paths) {
    of(w).listener_->on_anything();
    of(w).listener_->on_drop(std::vector<std::string>(paths, paths + count));
  });
  glfwShowWindow(window_);
  take_size();
}

void GlfwWindow::take_size() {
  int width = 0, height = 0;
  glfwGetFramebufferSize(window_, &width, &height);
  listener_->on_anything();
  listener_->on_resize(width, height);
}

/// Mouse places come in window units, which are not pixels on HiDPI screens.
glm::vec2 GlfwWindow::pixels(double x, double y) const {
  int window_w = 1, window_h = 1, w = 1, h = 1;
  glfwGetWindowSize(window_, &window_w, &window_h);
  glfwGetFramebufferSize(window_, &w, &h);
  return {static_cast<float>(x) * static_cast<float>(w) / static_cast<float>(std::max(window_w, 1)),
          static_cast<float>(y) * static_cast<float>(h) / static_cast<float>(std::max(window_h, 1))};
}

void GlfwWindow::on_cursor(double x, double y) {
  listener_->on_anything();
  const glm::vec2 now = pixels(x, y), by = now - cursor_;
  cursor_ = now;
  const auto held = [this](int button) { return glfwGetMouseButton(window_, button) == GLFW_PRESS; };
  const bool shift =
      glfwGetKey(window_, GLFW_KEY_LEFT_SHIFT) == GLFW_PRESS || glfwGetKey(window_, GLFW_KEY_RIGHT_SHIFT) == GLFW_PRESS;
  if (held(GLFW_MOUSE_BUTTON_RIGHT) || held(GLFW_MOUSE_BUTTON_MIDDLE) || (shift && held(GLFW_MOUSE_BUTTON_LEFT)))
    listener_->on_drag(WindowListener::Drag::kPan, by);
  else if (held(GLFW_MOUSE_BUTTON_LEFT))
    listener_->on_drag(WindowListener::Drag::kRotate, by);
}

void GlfwWindow::on_press() {
  const double now = glfwGetTime();
  const float close = kDoubleClickPx * std::max(content_scale(), pixels_per_unit());
  const bool again = now - pressed_s_ < kDoubleClickS && glm::length(cursor_ - pressed_at_) < close;
  pressed_s_ = again ? -1 : now;
  pressed_at_ = cursor_;
  if (again) listener_->on_double_click(cursor_);
}

void GlfwWindow::poll_events(double wait_s) {
  if (wait_s > 0)
    glfwWaitEventsTimeout(wait_s);
  else
    glfwPollEvents();
}

bool GlfwWindow::close_wanted() const {
  return glfwWindowShouldClose(window_) == GLFW_TRUE;
}

void GlfwWindow::swap() {
  glfwSwapBuffers(window_);
}

void GlfwWindow::set_title(const std::string& title) {
  glfwSetWindowTitle(window_, title.c_str());
}

float GlfwWindow::content_scale() const {
  float scale = 1, unused = 1;
  glfwGetWindowContentScale(window_, &scale, &unused);
  return std::max(scale, 1.0F);
}

float GlfwWindow::pixels_per_unit() const {
  const glm::vec2 unit = pixels(1, 1);
  return unit.x > 0 ? unit.x : 1;
}

double GlfwWindow::display_rate_hz() const {
  GLFWmonitor* monitor = glfwGetPrimaryMonitor();
  const GLFWvidmode* mode = monitor == nullptr ? nullptr : glfwGetVideoMode(monitor);
  return mode != nullptr && mode->refreshRate > 0 ? mode->refreshRate : 60;
}

glm::ivec2 GlfwWindow::size() const {
  glm::ivec2 size{0};
  glfwGetWindowSize(window_, &size.x, &size.y);
  return size;
}

std::string GlfwWindow::clipboard() const {
  const char* text = glfwGetClipboardString(window_);
  return text == nullptr ? std::string() : text;
}

void GlfwWindow::set_clipboard(const std::string& text) {
  glfwSetClipboardString(window_, text.c_str());
}

}  // namespace eigencast
