// SPDX-License-Identifier: MIT
#include "view/glfw_window.h"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <X11/Xlib.h>
#include <epoxy/glx.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <utility>

namespace eigencast {
namespace {

constexpr double kDoubleClickS = 0.35;
constexpr int kLargestPx = 1 << 15;  // Of a window that is gone GLFW says what its memory held.
constexpr float kDoubleClickPx = 6;  // at 96 dpi

std::string name_of_key(int key) {
  if ((key >= GLFW_KEY_A && key <= GLFW_KEY_Z) || key == GLFW_KEY_SPACE || key == GLFW_KEY_COMMA ||
      key == GLFW_KEY_PERIOD || key == GLFW_KEY_LEFT_BRACKET || key == GLFW_KEY_RIGHT_BRACKET ||
      key == GLFW_KEY_MINUS || key == GLFW_KEY_EQUAL) {
    return std::string(1, static_cast<char>(key));
  }
  constexpr std::array<std::pair<int, const char*>, 10> kNames{{{GLFW_KEY_KP_ADD, "+"},
                                                                {GLFW_KEY_KP_SUBTRACT, "-"},
                                                                {GLFW_KEY_HOME, "Home"},
                                                                {GLFW_KEY_END, "End"},
                                                                {GLFW_KEY_TAB, "Tab"},
                                                                {GLFW_KEY_DELETE, "Delete"},
                                                                {GLFW_KEY_BACKSPACE, "Delete"},
                                                                {GLFW_KEY_F1, "F1"},
                                                                {GLFW_KEY_F12, "F12"},
                                                                {GLFW_KEY_ESCAPE, "Escape"}}};
  const auto named = std::find_if(kNames.begin(), kNames.end(), [&](const auto& name) { return name.first == key; });
  return named == kNames.end() ? std::string() : named->second;
}

Modifiers modifiers_from(int bits) {
  return {(bits & GLFW_MOD_SHIFT) != 0, (bits & GLFW_MOD_CONTROL) != 0};
}

constexpr double kCheckEveryS = 0.5;

/// Xlib's handlers are the process's, and end it for what others do to its window. On Wayland nobody calls them.
std::atomic<int> x_errors{0};
std::atomic<bool> x_connection_lost{false};

void survive_x_errors() {
  x_errors.store(0);
  x_connection_lost.store(false);
  ::XSetErrorHandler([](::Display*, ::XErrorEvent*) {
    ++x_errors;
    return 0;
  });
  ::XSetIOErrorHandler([](::Display*) {
    x_connection_lost.store(true);
    return 0;
  });
  if (::Display* display = glXGetCurrentDisplay(); display != nullptr)
    ::XSetIOErrorExitHandler(
        display, [](::Display*, void*) {}, nullptr);
}

GlfwWindow& of(GLFWwindow* window) {
  return *static_cast<GlfwWindow*>(glfwGetWindowUserPointer(window));
}

}  // namespace

GlfwWindow::~GlfwWindow() {
  if (window_ != nullptr) glfwDestroyWindow(window_);
  if (started_) glfwTerminate();
}

Error GlfwWindow::no_window(const std::string& what_to_do) const {
  const char* why = nullptr;
  glfwGetError(&why);
  return fail(ErrorCode::kUnsupported, std::string("no window can be opened: ") +
                                           (why != nullptr ? why : "unknown reason") + ". " + what_to_do + ", " +
                                           instead_);
}

Result<void> GlfwWindow::start() {
  glfwSetErrorCallback(nullptr);
  started_ = glfwInit() == GLFW_TRUE;
  return started_ ? Result<void>() : no_window("Without a display");
}

Result<void> GlfwWindow::open(int width, int height, const std::string& title, bool shrink) {
  if (const Result<void> started = start(); !started) return started;
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
  if (window_ != nullptr) return {};
  return no_window(
      "The display must offer OpenGL 3.3: install its graphics driver (Debian: libgl1-mesa-dri); without one");
}

void GlfwWindow::make_current() const {
  glfwMakeContextCurrent(window_);
  glfwSwapInterval(1);
}

void GlfwWindow::release_current() {
  glfwMakeContextCurrent(nullptr);
}

void GlfwWindow::listen(WindowListener& listener) {
  listener_ = &listener;
  glfwSetWindowUserPointer(window_, this);
  glfwSetFramebufferSizeCallback(window_, [](GLFWwindow* w, int, int) { of(w).report_size(); });
  glfwSetWindowContentScaleCallback(window_, [](GLFWwindow* w, float, float) { of(w).report_size(); });
  glfwSetWindowRefreshCallback(window_, [](GLFWwindow* w) { of(w).listener_->on_event(); });
  glfwSetWindowFocusCallback(window_, [](GLFWwindow* w, int) { of(w).listener_->on_event(); });
  glfwSetCharCallback(window_, [](GLFWwindow* w, unsigned) { of(w).listener_->on_event(); });
  glfwSetKeyCallback(window_, [](GLFWwindow* w, int key, int, int action, int modifiers) {
    of(w).listener_->on_event();
    const std::string name = name_of_key(key);
    if (action != GLFW_RELEASE && !name.empty())
      of(w).listener_->on_key(name, modifiers_from(modifiers), action == GLFW_REPEAT);
  });
  glfwSetMouseButtonCallback(window_, [](GLFWwindow* w, int button, int action, int modifiers) {
    of(w).on_button(button, action == GLFW_PRESS, modifiers);
  });
  glfwSetCursorPosCallback(window_, [](GLFWwindow* w, double x, double y) { of(w).on_cursor(x, y); });
  glfwSetScrollCallback(window_, [](GLFWwindow* w, double, double steps) {
    of(w).listener_->on_event();
    of(w).listener_->on_wheel(static_cast<float>(steps), of(w).cursor_);
  });
  glfwSetDropCallback(window_, [](GLFWwindow* w, int count, const char** paths) {
    of(w).listener_->on_event();
    of(w).listener_->on_drop(std::vector<std::string>(paths, paths + count));
  });
  survive_x_errors();  // GLFW sets the default handlers again whenever it makes something
  glfwShowWindow(window_);
  report_size();
}

void GlfwWindow::report_size() {
  listener_->on_event();
  listener_->on_resize(size_px().x, size_px().y);
}

/// Converts window units, which are not pixels on HiDPI screens.
glm::vec2 GlfwWindow::pixels(double x, double y) const {
  return glm::vec2(x, y) * glm::vec2(size_px()) / glm::vec2(glm::max(size(), 1));
}

void GlfwWindow::on_cursor(double x, double y) {
  listener_->on_event();
  const glm::vec2 now = pixels(x, y), by = now - cursor_;
  cursor_ = now;
  listener_->on_move(now);
  const auto held = [this](int button) { return glfwGetMouseButton(window_, button) == GLFW_PRESS; };
  const bool shift =
      glfwGetKey(window_, GLFW_KEY_LEFT_SHIFT) == GLFW_PRESS || glfwGetKey(window_, GLFW_KEY_RIGHT_SHIFT) == GLFW_PRESS;
  if (held(GLFW_MOUSE_BUTTON_RIGHT) || held(GLFW_MOUSE_BUTTON_MIDDLE) || (shift && held(GLFW_MOUSE_BUTTON_LEFT)))
    listener_->on_drag(WindowListener::Drag::kPan, by);
  else if (held(GLFW_MOUSE_BUTTON_LEFT))
    listener_->on_drag(WindowListener::Drag::kRotate, by);
}

void GlfwWindow::on_button(int button, bool pressed, int modifiers) {
  listener_->on_event();
  const MouseButton which = button == GLFW_MOUSE_BUTTON_LEFT    ? MouseButton::kLeft
                            : button == GLFW_MOUSE_BUTTON_RIGHT ? MouseButton::kRight
                                                                : MouseButton::kMiddle;
  if (!pressed) return listener_->on_release(which);
  listener_->on_press(which, cursor_, modifiers_from(modifiers));  // the mouse itself may have moved on
  if (which == MouseButton::kLeft) detect_double_click();
}

void GlfwWindow::detect_double_click() {
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
  detect_loss();
}

/// GLFW says nothing of a window that another program has destroyed.
void GlfwWindow::detect_loss() {
  const double now = glfwGetTime();
  if (is_lost_ || (x_errors.exchange(0) == 0 && now - checked_s_ < kCheckEveryS)) return;
  checked_s_ = now;
  (void)size();
  is_lost_ = x_connection_lost.load() || x_errors.exchange(0) > 0;
}

bool GlfwWindow::close_wanted() const {
  return is_lost_ || glfwWindowShouldClose(window_) == GLFW_TRUE;
}

void GlfwWindow::swap() const {
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
  return glm::clamp(size, 0, kLargestPx);
}

glm::ivec2 GlfwWindow::size_px() const {
  glm::ivec2 size{0};
  glfwGetFramebufferSize(window_, &size.x, &size.y);
  return glm::clamp(size, 0, kLargestPx);
}

std::string GlfwWindow::clipboard() const {
  const char* text = glfwGetClipboardString(window_);
  return text == nullptr ? std::string() : text;
}

void GlfwWindow::set_clipboard(const std::string& text) {
  glfwSetClipboardString(window_, text.c_str());
}

}  // namespace eigencast
