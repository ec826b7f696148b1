// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "client/apps.h"
#include "client/clip_player.h"
#include "client/clip_source.h"
#include "client/scene_file.h"
#include "client/session.h"
#include "client/settings.h"
#include "client/ui/panel.h"
#include "client/viewer_state.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/text.h"
#include "common/net/url.h"
#include "view/glfw_window.h"
#include "view/overlay.h"
#include "view/renderer.h"

namespace eigencast {
namespace {

constexpr auto kIdleWait = std::chrono::milliseconds(6);  // latency of input while no pose comes
constexpr double kEmptyWaitS = 0.1;                       // likewise without sources
constexpr TimeUs kFiguresEveryUs = 250'000;
constexpr TimeUs kNoticeUs = 8'000'000;
constexpr TimeUs kPointEveryUs = 100'000;
constexpr double kTurnSeconds = 12;
constexpr double kSmooth = 30;  // pictures a second that move well

std::string shown_name(const std::string& stream) {
  const auto url = parse_broker_url(stream);
  return clip_in(stream).value_or(url ? url->shown() : "");
}

std::string title_for(const std::string& name) {
  return "Eigencast" + (name.empty() ? "" : " - " + name);
}

/// Draws only when something has changed. On the main thread.
class Viewer final : public WindowListener {
 public:
  Viewer(const ClientOptions& options, OpenSource open, LogSink log)
      : options_(options), open_(std::move(open)), log_(std::move(log)) {}

  ~Viewer() override {
    session_.reset();
    overlay_.reset();
    rebuilder_.gpu.reset();
    renderer_.reset();
  }

  /// The sources must outlive the viewer. Errors: kUnsupported (no window); as CameraPath::read, Session::create.
  Result<void> open(std::span<PoseSource* const> sources) {
    if (auto settings = Settings::load(options_.settings)) {
      settings_ = std::move(*settings);
    } else {
      log(log_, LogLevel::kWarning, settings.error().message);
    }
    const bool remembered = !options_.size_given && !options_.settings.empty();
    const int width = remembered ? settings_.width : options_.width;
    const int height = remembered ? settings_.height : options_.height;
    const std::string first = options_.scene.streams.empty() ? "" : shown_name(options_.scene.streams.front());
    if (const auto opened = window_.open(width, height, title_for(first), remembered); !opened) return opened;
    window_.make_current();
    if (const auto made = store(renderer_, Renderer::create()); !made) return made;
    ClientOptions mine = options_;
    if (settings_.resolver && !options_.resolver_given) mine.levels.kind = *settings_.resolver;
    if (settings_.playout && !options_.playout_given) {
      mine.view_options.playout.mode = *settings_.playout;
      mine.view_options.playout.smoothness = settings_.smoothness;
    }
    if (options_.follow_display) {
      mine.levels.target_fps = window_.display_rate_hz();
      mine.levels.least_fps = std::min(kSmooth, mine.levels.target_fps);
    }
    auto good = store(path_, CameraPath::read(options_.camera_path));
    if (good) good = store(session_, Session::create(mine, sources, log_));
    if (good) good = store(rebuilder_, choose_rebuilder(options_.reconstruct, *renderer_, false));
    if (!good) return good;
    session_->rebuild_with(rebuilder_);
    session_->set_pixel_scale(text_scale_now().of_picture());
    state_.playout = mine.view_options.playout;
    state_.style = options_.style_given ? options_.style : settings_.style;
    state_.style.colour = options_.style.colour;
    state_.style.colour_range = options_.style.colour_range;
    state_.hud = settings_.hud;
    state_.panel = settings_.panel;
    state_.turntable = options_.turntable_s > 0;
    camera_.set_view(options_.view);
    window_.listen(*this);
    overlay_ =
        std::make_unique<Overlay>(window_.handle(), text_scale_now());  // after listen(): ImGui chains our callbacks
    for (const std::string& stream : options_.scene.streams) {
      if (const std::string name = shown_name(stream); !name.empty()) settings_.opened(name);
    }
    return {};
  }

  bool closed() const { return window_.close_wanted() || state_.quit; }
  bool lost() const { return window_.is_lost(); }
  /// One turn: input, poses, a picture if either changed it, then files that the user wants.
  void turn() {
    window_.poll_events(redraw_ == 0 && session_->sources().empty() && !state_.turntable ? kEmptyWaitS : 0);
    RewindDesk& rewind = session_->rewind();
    if (rewind.take(state_)) stop_following();
    play_clips(session_->sources(), state_, steady_now_us());
    session_->scene().set_paused(rewind.bar() ? rewind.holds() : state_.paused);
    session_->scene().set_playout(playout());
    session_->scene().set_shading(state_.style);
    for (const std::string& text : {rewind.take_notice(), rewind.take_trouble()}) {
      if (!text.empty()) say(text, true);
    }
    const bool poses = session_->update(redraw_ > 0 ? std::chrono::milliseconds(0) : kIdleWait, camera_);
    const TimeUs now = steady_now_us();
    point(now);
    const bool scene_changed = move_camera(now) || poses;
    if (!scene_changed && redraw_ == 0 && !content_changed(now)) return;
    redraw_ = std::max(redraw_ - 1, 0);
    draw();
    if (const UiRequests wanted = std::exchange(requests_, {}); !wanted.open.empty() || wanted.remove) {
      if (wanted.remove) remove(*wanted.remove);
      if (!wanted.open.empty()) open_wanted(wanted.open);
      redraw_ = kRedrawsAfterInput;
    }
    write_what_is_wanted(scene_changed);
  }

  /// With its texts. Errors: kIo.
  Result<void> save(const std::string& path) {
    if (width_ < 1 || height_ < 1) return fail(ErrorCode::kUnsupported, path + ": the window has no picture now");
    const unsigned target = renderer_->offscreen_target(width_, height_);  // a back buffer is undefined after a swap
    renderer_->draw(camera_, session_->render_options(state_.style), width_, height_, target);
    overlay_->draw(overlay_content(), width_, height_, target, [this] { draw_panels(); });
    return write_png(path, Renderer::read_back(width_, height_, target, state_.style.transparent));
  }

  const Session& session() const { return *session_; }
  std::string report() const { return session_->report(*renderer_, width_, height_); }

  Result<void> remember() {
    if (options_.settings.empty()) return {};
    const glm::ivec2 size = window_.size();
    settings_.width = size.x;
    settings_.height = size.y;
    settings_.hud = state_.hud;
    settings_.panel = state_.panel;
    settings_.style = state_.style;
    settings_.resolver = session_->levels().kind();
    settings_.playout = state_.playout.mode;
    settings_.smoothness = state_.playout.smoothness;
    return settings_.save(options_.settings);
  }

 private:
  void on_resize(int width_px, int height_px) override {
    if (overlay_) overlay_->set_scale(text_scale_now());
    if (session_) session_->set_pixel_scale(text_scale_now().of_picture());
    width_ = width_px;
    height_ = height_px;
    camera_.set_viewport(width_, height_);
  }

  void on_event() override { redraw_ = kRedrawsAfterInput; }

  void on_key(const std::string& name, const Modifiers& modifiers, bool repeated) override {
    if (overlay_ && overlay_->wants_keys()) return;
    const KeyCommand* wanted = command_for_key(name, modifiers);
    if (wanted == nullptr || (repeated && !wanted->repeats)) return;
    wanted->apply({state_, camera_, session_->scene().lod()});
    do_what_keys_wanted();  // now, before the camera to copy moves on
  }

  void on_press(MouseButton, glm::vec2 at_px, const Modifiers&) override { on_button(at_px); }
  void on_release(MouseButton) override { on_button(cursor_px_); }
  /// A drag that begins on a panel is the panel's, however soon it leaves it.
  void on_button(glm::vec2 at_px) {
    if (overlay_ && width_ > 0) overlay_->take_button(at_px, overlay_content(), [this] { draw_panels(); });
  }

  void on_move(glm::vec2 at_px) override { cursor_px_ = at_px; }

  void on_drag(Drag drag, glm::vec2 by_px) override {
    if (overlay_ && overlay_->wants_mouse()) return;
    stop_following();
    drag == Drag::kPan ? camera_.pan(by_px) : camera_.rotate(by_px);
  }

  void on_wheel(float steps, glm::vec2 at_px) override {
    if (overlay_ && overlay_->wants_mouse()) return;
    stop_following();
    camera_.zoom(steps, at_px);
  }

  void on_double_click(glm::vec2 at_px) override {
    if (overlay_ && overlay_->wants_mouse()) return;
    stop_following();
    if (const auto hit = pick(session_->scene(), camera_, at_px, width_, height_)) camera_.look_at(hit->at);
  }

  void on_drop(const std::vector<std::string>& what) override {
    for (const std::string& each : what) open_wanted(each);
  }

  static constexpr int kRedrawsAfterInput = 4;  ///< Panels react to input some pictures later.

  void open_wanted(const std::string& text) {
    const Wanted wanted = wanted_from(text);
    if (wanted.kind == Wanted::Kind::kNothing) return;
    const Result<void> opened =
        wanted.kind == Wanted::Kind::kScene ? add_scene(wanted.what) : add_stream(wanted.what, {});
    if (!opened) return say(opened.error().message, true);
    to_open_.fill('\0');
    const std::string name = wanted.kind == Wanted::Kind::kScene ? wanted.what : shown_name(wanted.what);
    if (!name.empty()) settings_.opened(name);
    window_.set_title(title_for(name));
  }

  Result<void> add_stream(const std::string& stream, const Placement& placement) {
    if (session_->scene().instances().size() >= kMaxSurfaces)
      return fail(ErrorCode::kTooLarge, "a scene holds at most " + std::to_string(kMaxSurfaces) + " surfaces");
    const auto there =
        std::find_if(opened_.begin(), opened_.end(), [&](const Opened& o) { return o.stream == stream; });
    if (there != opened_.end()) {
      session_->add(*there->source, shown_name(stream), placement);
      return {};
    }
    Result<std::unique_ptr<PoseSource>> source = open_(stream);
    if (!source) return source.error();
    opened_.push_back({stream, std::move(*source)});
    session_->add(*opened_.back().source, shown_name(stream), placement);
    return {};
  }

  Result<void> add_scene(const std::string& path) {
    const Result<SceneDescription> scene = read_scene_file(path);
    if (!scene) return scene.error();
    for (const Placement& placement : scene->placements) {
      if (const auto added = add_stream(scene->streams[placement.source], placement); !added) return added;
    }
    return {};
  }

  void remove(std::size_t surface) {
    const PoseSource* gone = session_->remove(surface);
    std::erase_if(opened_, [&](const Opened& each) { return gone != nullptr && each.source.get() == gone; });
  }

  void say(const std::string& notice, bool bad) {
    notice_ = notice;
    notice_until_us_ = steady_now_us() + (bad ? kNoticeUs : kNoticeUs / 3);
    log(log_, bad ? LogLevel::kError : LogLevel::kInfo, notice);
  }

  /// Along the camera path in a loop, or around the scene.
  bool move_camera(TimeUs now_us) {
    const double since = turned_us_ == 0 ? 0 : static_cast<double>(now_us - turned_us_) / 1e6;
    turned_us_ = now_us;
    if (path_) {
      if (!flight_began_us_) flight_began_us_ = now_us;
      const double flown = static_cast<double>(now_us - *flight_began_us_) / 1e6;
      path_->apply(path_->seconds() > 0 ? std::fmod(flown, path_->seconds()) : 0, camera_);
      return true;
    }
    if (!state_.turntable || session_->scene().instances().empty()) return false;
    const double turn_s = options_.turntable_s > 0 ? options_.turntable_s : kTurnSeconds;
    camera_.turn(static_cast<float>(since * 6.283185307 / turn_s));
    return true;
  }

  void stop_following() {
    if (RoomDesk* room = session_ ? session_->room() : nullptr) room->stop_following();
  }

  /// With the panel's note, at the cursor.
  void pin(RoomDesk& room) {
    const auto hit = pick(session_->scene(), camera_, cursor_px_, width_, height_, session_->sources());
    const auto point = hit ? RoomDesk::point_of(*hit, session_->scene(), session_->sources()) : std::nullopt;
    if (!point || !room.state().speaks) return say(point ? "you may not speak here" : "no surface here", true);
    room.pin(*point, std::exchange(state_.note, {}).data());
  }

  /// Says where the cursor is on a surface.
  void point(TimeUs now_us) {
    RoomDesk* room = session_->room();
    if (room == nullptr || !room->state().speaks || cursor_px_ == pointed_px_ || now_us - pointed_us_ < kPointEveryUs)
      return;
    pointed_px_ = cursor_px_;
    pointed_us_ = now_us;
    const auto hit =
        overlay_->wants_mouse() ? std::nullopt : pick(session_->scene(), camera_, cursor_px_, width_, height_);
    room->point_at(hit ? RoomDesk::point_of(*hit, session_->scene(), session_->sources()) : std::nullopt);
  }

  void do_what_keys_wanted() {
    for (; state_.colourings_on > 0; --state_.colourings_on)
      state_.style.colour = next_colouring(session_->sources(), state_.style.colour);
    if (std::exchange(state_.resolver_wanted, false))
      session_->levels().set_kind(next_of(session_->levels().kind(), 3));
    const bool pins = std::exchange(state_.pin_wanted, false), leads = std::exchange(state_.lead_wanted, false),
               follows = std::exchange(state_.follow_wanted, false);
    if (RoomDesk* room = session_->room()) {
      if (pins) pin(*room);
      if (leads) room->lead(!room->leads());
      if (follows) room->follows() ? room->stop_following() : room->follow();
    }
    if (std::exchange(state_.copy_wanted, false)) {
      window_.set_clipboard(text_from_camera(camera_));
      say("the camera is in the clipboard", false);
    }
    if (!std::exchange(state_.paste_wanted, false)) return;
    if (const std::string text = window_.clipboard(); !camera_from_text(text, camera_)) open_wanted(text);
  }

  bool content_changed(TimeUs now_us) {
    const bool fading = session_->colourfulness() != drawn_colourfulness_ || session_->colours().is_waiting();
    if (now_us - checked_us_ < (fading ? 30'000 : kFiguresEveryUs)) return false;
    checked_us_ = now_us;
    return fading || state_.panel || overlay_->wants_keys() || !(overlay_content() == drawn_content_);
  }

  OverlayContent overlay_content() const {
    OverlayContent content = session_->overlay_content();
    if (!state_.hud || session_->figures().vertices_total == 0) content.figures.clear();
    if (!state_.style.legend) content.legend.reset();
    if (steady_now_us() < notice_until_us_) content.banner = notice_;
    content.labels = session_->labels(camera_);
    if (state_.panel) content.left_px = panel_width(overlay_->scale());
    content.paused = state_.paused && !has_bar();
    if (state_.help) content.help = help_lines(state_, camera_, session_->scene().lod(), session_->levels().kind());
    return content;
  }

  TextScale text_scale_now() const {
    return text_scale(window_.content_scale(), window_.pixels_per_unit(), static_cast<float>(options_.ui_scale));
  }

  void draw() {
    if (width_ < 1 || height_ < 1) return;
    // With a resolver the picture is drawn off-screen, so that waiting for the display does not count as work.
    const bool apart = session_->levels().active();
    const unsigned target = apart ? renderer_->offscreen_target(width_, height_) : 0;
    Style style = state_.style;
    style.transparent = false;
    session_->draw(*renderer_, camera_, style, width_, height_, target);
    drawn_content_ = overlay_content();
    drawn_colourfulness_ = session_->colourfulness();
    overlay_->draw(drawn_content_, width_, height_, target, [this] { draw_panels(); });
    session_->finish_picture(false);
    if (apart) Renderer::copy_to_window(target, width_, height_);
    window_.swap();
    if (apart) Renderer::finish();  // so that the display's wait ends here
  }

  /// What is slower than it was sent moves evenly, as clips do.
  PlayoutSettings playout() const {
    PlayoutSettings settings = state_.playout;
    const bool is_slow = session_->rewind().past_us() && state_.speed < 1 && settings.mode == PlayoutMode::kLatest;
    if (is_slow) settings.mode = PlayoutMode::kInterpolate;
    return settings;
  }
  const Timeline* timeline() const { return leading_timeline(session_->sources()); }
  bool has_bar() const { return state_.hud && (timeline() != nullptr || session_->rewind().bar()); }

  void draw_panels() {
    if (has_bar() && timeline() != nullptr) {
      draw_timeline(*timeline(), state_, steady_now_us(), overlay_->scale());
    } else if (has_bar()) {
      draw_past(*session_->rewind().bar(), state_, overlay_->scale());
    }
    UiRequests made;
    if (session_->scene().instances().empty()) {
      made = draw_welcome(settings_.recent, to_open_, overlay_->scale());
    } else if (state_.panel) {
      made = draw_panel(*session_, state_, to_open_, overlay_->scale());
    }
    if (!made.open.empty() || made.remove) requests_ = made;
  }

  void write_what_is_wanted(bool scene_changed) {
    for (bool* wanted : {&state_.screenshot_wanted, &state_.clean_screenshot_wanted}) {
      if (!std::exchange(*wanted, false)) continue;
      const std::string path = next_free_name("eigencast", ".png");
      const auto written = wanted == &state_.screenshot_wanted ? save(path) : save_scene(path, true);
      written ? say("screenshot: " + path, false) : say(written.error().message, true);
    }
    if (!state_.recording) record_folder_.clear();
    if (!state_.recording || !scene_changed) return;
    if (record_folder_.empty()) {
      record_folder_ = next_free_name("eigencast_pictures", "");
      recorded_ = 0;
      std::error_code error;
      std::filesystem::create_directories(record_folder_, error);
      log(log_, LogLevel::kInfo, "writing every picture to " + record_folder_);
    }
    const std::string name = formatted("frame_%06llu.png", static_cast<unsigned long long>(++recorded_));
    const Result<void> written = save_scene((std::filesystem::path(record_folder_) / name).string(), false);
    if (written) return;
    state_.recording = false;
    say(written.error().message, true);
  }

  Result<void> save_scene(const std::string& path, bool transparent) {
    Style style = state_.style;
    style.transparent |= transparent;
    Result<Picture> picture = renderer_->picture(camera_, session_->render_options(style), width_, height_);
    return picture ? write_png(path, *picture) : Result<void>(picture.error());
  }

  const ClientOptions options_;
  const OpenSource open_;
  const LogSink log_;
  GlfwWindow window_{"write --film film.mp4, or pictures with --headless --frames 90 --out DIR"};
  // Renderer, rebuilder and overlay need the window's context for destruction.
  std::unique_ptr<Renderer> renderer_;
  RebuilderChoice rebuilder_;
  std::unique_ptr<Overlay> overlay_;
  struct Opened {
    std::string stream;
    std::unique_ptr<PoseSource> source;
  };
  std::vector<Opened> opened_;  ///< By the user.
  std::unique_ptr<Session> session_;
  Camera camera_;
  ViewerState state_;
  Settings settings_;
  TextField to_open_{};
  UiRequests requests_;
  std::optional<CameraPath> path_;
  std::optional<TimeUs> flight_began_us_;
  TimeUs turned_us_ = 0, checked_us_ = 0;
  std::string notice_;
  TimeUs notice_until_us_ = 0;
  std::string record_folder_;
  std::uint64_t recorded_ = 0;
  OverlayContent drawn_content_;
  float drawn_colourfulness_ = 1;
  int redraw_ = kRedrawsAfterInput;
  int width_ = 0, height_ = 0;
  glm::vec2 cursor_px_{0}, pointed_px_{0};
  TimeUs pointed_us_ = 0;
};

Result<void> write_results(Viewer& viewer, const ClientOptions& options) {
  if (!options.screenshot.empty()) {
    if (Result<void> written = viewer.save(options.screenshot); !written) return written;
  }
  return options.json.empty() ? Result<void>() : write_file_atomically(options.json, viewer.report());
}

}  // namespace

int run_window(const ClientOptions& options, std::span<PoseSource* const> sources, const OpenSource& open,
               const std::atomic<bool>& stop, const LogSink& log_sink) {
  Viewer viewer(options, open, log_sink);
  if (const Result<void> ready = viewer.open(sources); !ready) return failed(ready.error(), log_sink);
  // After the start of the renderer, whose threads must not inherit this.
  run_when_woken(kMakingPoses);
  const TimeUs start = steady_now_us();
  while (!stop.load() && !viewer.closed()) {
    if (options.duration_s > 0 && static_cast<double>(steady_now_us() - start) / 1e6 >= options.duration_s) break;
    if (options.frames > 0 && viewer.session().scene().poses_shown() >= options.frames) break;
    viewer.turn();
  }
  if (viewer.lost()) {
    log(log_sink, LogLevel::kError, "the window is gone: another program destroyed it, or its display ended");
    return kExitFailed;
  }
  if (const Result<void> remembered = viewer.remember(); !remembered)
    log(log_sink, LogLevel::kWarning, remembered.error().message);
  const Result<void> written = write_results(viewer, options);
  return written ? kExitGood : failed(written.error(), log_sink);
}

}  // namespace eigencast
