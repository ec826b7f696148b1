// SPDX-License-Identifier: MIT
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>
#include <cmath>

#include "client/apps.h"
#include "client/camera_path.h"
#include "client/clip_source.h"
#include "client/session.h"
#include "client/viewer_state.h"
#include "common/core/files.h"
#include "common/net/url.h"
#include "view/overlay.h"
#include "view/renderer.h"

namespace eigencast {
namespace {

constexpr auto kIdleWait = std::chrono::milliseconds(6);  // how late a key or drag may be noticed while no pose comes
constexpr TimeUs kFiguresEveryUs = 250'000;

std::string name_of_key(int key) {
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

/// GLFW's library and the one window; input goes to camera and state.
class Window {
 public:
  ~Window() {
    overlay_.reset();
    renderer_.reset();
    if (window_ != nullptr) glfwDestroyWindow(window_);
    if (library_) glfwTerminate();
  }

  Result<void> open(const ClientOptions& options, std::span<PoseSource* const> sources, const LogSink& log_sink) {
    glfwSetErrorCallback(nullptr);
    if (glfwInit() != GLFW_TRUE) return no_window();
    library_ = true;
    glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
    glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
    glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
    glfwWindowHint(GLFW_OPENGL_FORWARD_COMPAT, GLFW_TRUE);
    // Not the URL as it was given: it may hold a token.
    const std::string stream = options.scene.streams.empty() ? "" : options.scene.streams.front();
    const auto url = parse_broker_url(stream);
    const std::string shown = url ? url->shown() : clip_in(stream).value_or("");
    const std::string title = "Eigencast" + (shown.empty() ? "" : " - " + shown);
    window_ = glfwCreateWindow(options.width, options.height, title.c_str(), nullptr, nullptr);
    if (window_ == nullptr) return no_window();
    glfwMakeContextCurrent(window_);
    glfwSwapInterval(1);
    Result<std::unique_ptr<Renderer>> renderer = Renderer::create();
    if (!renderer) return renderer.error();
    renderer_ = std::move(renderer).value();
    ClientOptions mine = options;
    if (options.follow_display) mine.levels.target_fps = display_rate_hz();
    if (!options.camera_path.empty()) {
      Result<CameraPath> path = CameraPath::read(options.camera_path);
      if (!path) return path.error();
      path_.emplace(std::move(*path));
    }
    Result<std::unique_ptr<Session>> session = Session::create(mine, sources, log_sink);
    if (!session) return session.error();
    session_ = std::move(session).value();
    state_.playout = options.view_options.playout;
    state_.look = options.look;
    camera_.set_view(options.view);
    take_size();
    listen();
    float scale = 1, unused = 1;
    glfwGetWindowContentScale(window_, &scale, &unused);
    overlay_ = std::make_unique<Overlay>(window_, std::max(scale, 1.0F));  // after listen(): it calls our handlers too
    return {};
  }

  bool closed() const { return glfwWindowShouldClose(window_) == GLFW_TRUE || state_.quit; }

  /// One turn: input, poses, and a picture if either changed it. Returns whether it drew.
  bool turn() {
    glfwPollEvents();
    session_->scene().set_paused(state_.paused);
    const bool changed = session_->update(needs_redraw_ ? std::chrono::milliseconds(0) : kIdleWait, camera_);
    if (fly()) needs_redraw_ = true;
    const TimeUs now = steady_now_us();
    const bool figures_are_old =
        now - drawn_us_ >= kFiguresEveryUs || (!session_->is_connected() && now - drawn_us_ >= 50'000);
    if (!changed && !needs_redraw_ && !figures_are_old) return false;
    draw();
    needs_redraw_ = false;
    drawn_us_ = now;
    return true;
  }

  Result<void> save_wanted_screenshot(const LogSink& log_sink) {
    if (!state_.screenshot_wanted) return {};
    state_.screenshot_wanted = false;
    const std::string path = next_screenshot_name("eigencast");
    const Result<void> written = save(path);
    if (written) log(log_sink, LogLevel::kInfo, "screenshot: " + path);
    return written;
  }

  Result<void> save(const std::string& path) {
    draw_picture();  // the back buffer's content is undefined after a swap
    return write_png(path, Renderer::read_back(width_, height_, renderer_->offscreen_target(width_, height_),
                                               state_.look.transparent));
  }

  Session& session() { return *session_; }
  std::string report() const { return session_->report(*renderer_, width_, height_); }

 private:
  static Error no_window() {
    const char* why = nullptr;
    glfwGetError(&why);
    return fail(ErrorCode::kUnsupported,
                std::string("no window can be opened: ") + (why != nullptr ? why : "unknown reason") +
                    ". Without a display, --headless --frames 90 --out DIR writes pictures instead");
  }

  static double display_rate_hz() {
    GLFWmonitor* monitor = glfwGetPrimaryMonitor();
    const GLFWvidmode* mode = monitor == nullptr ? nullptr : glfwGetVideoMode(monitor);
    return mode != nullptr && mode->refreshRate > 0 ? mode->refreshRate : 60;
  }

  /// Moves the camera along its path, again and again; the first turn starts it.
  bool fly() {
    if (!path_) return false;
    if (!flight_began_us_) flight_began_us_ = steady_now_us();
    const double flown = static_cast<double>(steady_now_us() - *flight_began_us_) / 1e6;
    path_->apply(path_->seconds() > 0 ? std::fmod(flown, path_->seconds()) : 0, camera_);
    return true;
  }

  void take_size() {
    glfwGetFramebufferSize(window_, &width_, &height_);
    camera_.set_viewport(width_, height_);
    needs_redraw_ = true;
  }

  OverlayContent overlay_content() const {
    OverlayContent content;
    if (state_.hud) content.figures = hud_lines(session_->figures());
    content.connection = session_->connection();
    content.connected = session_->is_connected();
    content.banner = session_->banner();
    content.paused = state_.paused;
    if (state_.look.legend) content.legend = session_->legend();
    if (content.banner.empty()) content.banner = session_->why_not_painted();
    if (state_.help) content.help = help_lines(state_, camera_, session_->scene().lod(), session_->levels().kind());
    return content;
  }

  /// A window has something behind it in any case.
  Look shown_look() const {
    Look look = state_.look;
    look.transparent = false;
    return look;
  }

  void draw() {
    if (width_ < 1 || height_ < 1) return;
    session_->draw(*renderer_, camera_, shown_look(), width_, height_, 0, false);
    overlay_->draw(overlay_content(), width_, height_, 0);
    glfwSwapBuffers(window_);
  }

  void draw_picture() {
    const unsigned target = renderer_->offscreen_target(width_, height_);
    renderer_->draw(camera_, session_->render_options(state_.look), width_, height_, target);
    overlay_->draw(overlay_content(), width_, height_, target);
  }

  static Window& of(GLFWwindow* window) { return *static_cast<Window*>(glfwGetWindowUserPointer(window)); }

  void listen() {
    glfwSetWindowUserPointer(window_, this);
    glfwSetFramebufferSizeCallback(window_, [](GLFWwindow* w, int, int) { of(w).take_size(); });
    glfwSetWindowRefreshCallback(window_, [](GLFWwindow* w) { of(w).needs_redraw_ = true; });
    glfwSetKeyCallback(window_, [](GLFWwindow* w, int key, int, int action, int) { of(w).on_key(key, action); });
    glfwSetCursorPosCallback(window_, [](GLFWwindow* w, double x, double y) { of(w).on_cursor(x, y); });
    glfwSetScrollCallback(window_, [](GLFWwindow* w, double, double steps) { of(w).on_wheel(steps); });
  }

  void on_key(int key, int action) {
    if (action == GLFW_RELEASE) return;
    const std::optional<Action> wanted = action_for_key(name_of_key(key));
    const bool repeats = wanted == Action::kFiner || wanted == Action::kCoarser || wanted == Action::kSmoother ||
                         wanted == Action::kMoreLive;
    if (!wanted || (action == GLFW_REPEAT && !repeats)) return;
    state_.apply(*wanted, camera_, session_->scene().lod());
    session_->scene().set_playout(state_.playout);
    if (state_.colouring_wanted) {
      state_.colouring_wanted = false;
      state_.look.colour = session_->next_colouring(state_.look.colour);
    }
    if (state_.resolver_wanted) {
      state_.resolver_wanted = false;
      session_->levels().set_kind(next_kind(session_->levels().kind()));
    }
    needs_redraw_ = true;
  }

  /// Mouse places come in window units, which are not pixels on HiDPI screens.
  glm::vec2 pixels(double x, double y) const {
    int w = 1, h = 1;
    glfwGetWindowSize(window_, &w, &h);
    return {static_cast<float>(x) * static_cast<float>(width_) / static_cast<float>(std::max(w, 1)),
            static_cast<float>(y) * static_cast<float>(height_) / static_cast<float>(std::max(h, 1))};
  }

  void on_cursor(double x, double y) {
    const glm::vec2 now = pixels(x, y), drag = now - cursor_;
    cursor_ = now;
    const auto held = [this](int button) { return glfwGetMouseButton(window_, button) == GLFW_PRESS; };
    const bool shift = glfwGetKey(window_, GLFW_KEY_LEFT_SHIFT) == GLFW_PRESS ||
                       glfwGetKey(window_, GLFW_KEY_RIGHT_SHIFT) == GLFW_PRESS;
    if (held(GLFW_MOUSE_BUTTON_RIGHT) || held(GLFW_MOUSE_BUTTON_MIDDLE) || (shift && held(GLFW_MOUSE_BUTTON_LEFT))) {
      camera_.pan(drag);
    } else if (held(GLFW_MOUSE_BUTTON_LEFT)) {
      camera_.rotate(drag);
    } else {
      return;
    }
    needs_redraw_ = true;
  }

  void on_wheel(double steps) {
    camera_.zoom(static_cast<float>(steps), cursor_);
    needs_redraw_ = true;
  }

  bool library_ = false, needs_redraw_ = true;
  GLFWwindow* window_ = nullptr;
  std::unique_ptr<Renderer> renderer_;
  std::unique_ptr<Overlay> overlay_;
  std::unique_ptr<Session> session_;
  Camera camera_;
  ViewerState state_;
  std::optional<CameraPath> path_;
  std::optional<TimeUs> flight_began_us_;
  glm::vec2 cursor_{0};
  int width_ = 0, height_ = 0;
  TimeUs drawn_us_ = 0;
};

Result<void> write_results(Window& window, const ClientOptions& options) {
  if (!options.screenshot.empty()) {
    if (Result<void> written = window.save(options.screenshot); !written) return written;
  }
  return options.json.empty() ? Result<void>() : write_file_atomically(options.json, window.report());
}

}  // namespace

int run_window(const ClientOptions& options, std::span<PoseSource* const> sources, const std::atomic<bool>& stop,
               const LogSink& log_sink) {
  Window window;
  if (const Result<void> ready = window.open(options, sources, log_sink); !ready) {
    log(log_sink, LogLevel::kError, ready.error().message);
    return kExitFailed;
  }
  const TimeUs start = steady_now_us();
  while (!stop.load() && !window.closed()) {
    if (options.duration_s > 0 && static_cast<double>(steady_now_us() - start) / 1e6 >= options.duration_s) break;
    if (options.frames > 0 && window.session().scene().poses_shown() >= options.frames) break;
    window.turn();
    // A screenshot that fails is no reason to close the window.
    if (const Result<void> saved = window.save_wanted_screenshot(log_sink); !saved) {
      log(log_sink, LogLevel::kError, saved.error().message);
    }
  }
  if (const Result<void> written = write_results(window, options); !written) {
    log(log_sink, LogLevel::kError, written.error().message);
    return kExitFailed;
  }
  return kExitGood;
}

}  // namespace eigencast
