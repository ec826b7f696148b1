// SPDX-License-Identifier: MIT
#include "sender/studio/studio.h"

#include <algorithm>

#include "common/net/url.h"
#include "common/surface/vector.h"
#include "sender/studio/hand.h"

namespace eigencast::studio {
namespace {

constexpr const char* kInstead = "--script deforms instead of a hand";
constexpr TimeUs kHeartbeatUs = 500'000, kFiguresEveryUs = 250'000, kMaxWaitUs = 50'000;

std::vector<HelpLine> help_of(Tool tool) {
  return {{"left drag", "a handle: move what is chosen; a knob: the tool; else turn the view", ""},
          {"Shift+left drag", "choose by a rectangle", ""},
          {"Shift+click", "choose one more, or one less", ""},
          {"middle, right drag; wheel", "move the view; zoom", ""},
          {"M R S T B", "move, rotate, scale, twist, bend", std::string(kToolNames[tool])},
          {"A  Esc", "choose all; none, or give a drag up", ""},
          {"Ctrl+Z  Ctrl+Y", "undo, redo", ""},
          {"Delete", "back to rest", ""},
          {"V", "full detail, or as viewers get it", ""},
          {"C  E  F", "cage, edges, figures", ""},
          {"Home", "the first view", ""},
          {"H  F1", "this help", ""},
          {"Q", "quit", ""}};
}

std::vector<Vec3> shifted(std::span<const Vec3> points, const Vec3& by) {
  std::vector<Vec3> moved(points.begin(), points.end());
  for (Vec3& p : moved) p = p + by;
  return moved;
}

class Studio final : public WindowListener {
 public:
  Studio(const Options& options, deform::Deformer& deformer, deform::ProjectedDeformer& projected, const Asset& asset,
         Publisher& publisher)
      : options_(options),
        deformer_(deformer),
        projected_(projected),
        asset_(asset),
        publisher_(publisher),
        editor_(shifted(deformer.handles(), -1 * asset.origin)),
        hand_(editor_, camera_),
        local_(asset, deformer.linear_map()),
        pace_(static_cast<TimeUs>(1e6 / options.rate_hz), kHeartbeatUs) {}

  Result<void> open(const LogSink& log) {
    Painter::Options painting;
    for (const SubscriberOptions& wanted : options_.watch) {
      Result<std::unique_ptr<PoseSource>> source = subscribe_to(wanted, log);
      if (!source) return source.error();
      painting.others.push_back(std::move(*source));
      painting.names.push_back(parse_broker_url(wanted.url)->stream);
    }
    const Result<void> opened = window_.open(options_.width, options_.height, options_.title);
    if (!opened) return opened;
    painting.window = &window_;
    painting.scale = window_.content_scale();
    painting.log = log;
    if (asset_.up_axis == Asset::UpAxis::kX) camera_.set_up(Camera::Up::kX);
    if (asset_.up_axis == Asset::UpAxis::kZ) camera_.set_up(Camera::Up::kZ);
    on_resize(window_.size_px().x, window_.size_px().y);
    frame(camera_, glm_from(asset_.box_low), glm_from(asset_.box_high), editor_.rest());
    painting.low = camera_.scene_low();
    painting.high = camera_.scene_high();
    if (!camera_.set_view(options_.view))
      return fail(ErrorCode::kInvalidArgument, "no view is called " + options_.view);
    if (const Result<void> posed = make_pose(); !posed) return posed;
    make_surface();
    if (const auto started = store(painter_, Painter::start(std::move(painting))); !started) return started;
    window_.listen(*this);
    return {};
  }

  Result<void> run(const std::function<bool()>& stop) {
    const TimeUs end_us =
        options_.duration_s > 0 ? steady_now_us() + static_cast<TimeUs>(options_.duration_s * 1e6) : 0;
    while (!quit_ && !window_.close_wanted() && !stop()) {
      const TimeUs now_us = steady_now_us();
      if (end_us > 0 && now_us >= end_us) break;
      const TimeUs wait_us = std::clamp<TimeUs>(pace_.due_us(now_us) - now_us, 0, kMaxWaitUs);
      window_.poll_events(static_cast<double>(wait_us) * 1e-6);
      if (const Result<void> posed = make_pose(); !posed) return posed;
      send_if_due();
      make_surface();
      if (const auto box = painter_->take_box()) {
        frame(camera_, box->first, box->second, editor_.rest());
        redraw_ = true;
      }
      if (!redraw_ && steady_now_us() - shown_us_ < kFiguresEveryUs) continue;
      show();
      redraw_ = false;
      shown_us_ = steady_now_us();
    }
    return {};
  }

  Report report() const {
    Report all = report_;
    all.painting = painter_->report();
    all.rms = local_.rms();
    all.max = local_.max();
    return all;
  }

 private:
  void on_event() override { redraw_ = true; }
  void on_resize(int width_px, int height_px) override {
    width_ = width_px;
    height_ = height_px;
    if (width_ > 0 && height_ > 0) camera_.set_viewport(width_, height_);
  }
  void on_key(const std::string& name, const Modifiers& modifiers, bool) override {
    on_input();
    if (const auto command = command_for_key(name, modifiers)) on_command(*command);
  }
  void on_wheel(float steps, glm::vec2) override {
    on_input();
    hand_.wheel(steps);
  }
  void on_move(glm::vec2 at_px) override {
    on_input();
    hand_.move(at_px);
  }
  void on_press(MouseButton button, glm::vec2 at_px, const Modifiers& modifiers) override {
    on_input();
    hand_.press(button, at_px, modifiers);
  }
  void on_release(MouseButton button) override {
    on_input();
    hand_.release(button);
  }
  void on_command(Command command) {
    if (hand_.command(command)) return;
    if (command == Command::kQuit) {
      quit_ = true;
      return;
    }
    bool& toggled = command == Command::kShow      ? received_
                    : command == Command::kCage    ? cage_
                    : command == Command::kEdges   ? edges_
                    : command == Command::kFigures ? figures_
                                                   : help_;
    toggled = !toggled;
  }

  void on_input() { input_us_ = steady_now_us(); }
  Result<void> make_pose() {
    const std::span<const Vec3> handles = editor_.handles();
    if (std::equal(handles.begin(), handles.end(), posed_.begin(), posed_.end())) {
      input_us_.reset();
      return {};
    }
    posed_.assign(handles.begin(), handles.end());
    if (const auto good = store(C_, projected_.coefficients(shifted(posed_, asset_.origin))); !good) return good;
    y_ = deformer_.controls(posed_);
    ++pose_;
    redraw_ = true;
    pose_input_us_ = std::exchange(input_us_, std::nullopt);
    pace_.changed();
    if (!pose_input_us_) return {};
    if (unsent_) ++report_.held_back;
    unsent_ = true;
    ++report_.poses;
    report_.input_to_coefficients_us.add(steady_now_us() - *pose_input_us_);
    return {};
  }

  void send_if_due() {
    const TimeUs now_us = steady_now_us(), due_us = pace_.due_us(now_us);
    if (due_us > now_us) return;
    const bool by_hand = std::exchange(unsent_, false), at_once = by_hand && due_us <= *pose_input_us_;
    // Capture time is that of the input, or, of a pose that the pace delayed, the time of sending.
    (void)publisher_.send_coefficients(C_, at_once ? *pose_input_us_ : now_us);  // The publisher counts what it drops.
    pace_.sent(now_us);
    if (at_once)
      report_.input_to_sent_us.add(steady_now_us() - *pose_input_us_);
    else if (by_hand)
      ++report_.held_back;
  }

  /// After sending, because the others wait longer for the pose.
  void make_surface() {
    if (surface_ && surface_pose_ == pose_ && surface_received_ == received_) return;
    const bool by_hand = surface_pose_ != pose_ && pose_input_us_;
    surface_pose_ = pose_;
    surface_received_ = received_;
    local_.show_received(received_);
    local_.set(y_, C_);
    surface_ = std::make_shared<const SurfaceGeometry>(local_.geometry());
    redraw_ = true;
    if (by_hand) report_.input_to_pose_us.add(steady_now_us() - *pose_input_us_);
  }

  void show() {
    const Publisher::Stats stats = publisher_.stats();
    Picturing state;
    state.camera = camera_;
    state.options.edges = edges_;
    state.markup = hand_.markup(deformer_.handle_faces());
    if (!cage_) state.markup.lines.clear(), state.markup.dots.clear();
    state.width_px = width_;
    state.height_px = height_;
    state.surface = surface_;
    state.pose = pose_;
    state.input_us = pose_input_us_;
    if (figures_) state.figures = figures();
    state.connected = stats.state == Publisher::State::kLive;
    state.connection =
        state.connected ? "on the air, " + std::to_string(stats.subscribers) + " watching" : stats.detail;
    if (help_) state.help = help_of(hand_.tool());
    painter_->show(std::move(state));
  }

  std::vector<std::string> figures() const {
    const std::size_t chosen = editor_.chosen_count();
    const std::string error =
        deformer_.linear_map() == nullptr
            ? "what is sent is all there is"
            : formatted("%s, sent within %.2g rms, %.2g largest, of the diagonal",
                        local_.received_shown() ? "as viewers get it" : "full detail", local_.rms(), local_.max());
    return {std::string(kToolNames[hand_.tool()]) + ", " + (chosen == 0 ? "all" : std::to_string(chosen) + " of") +
                " " + std::to_string(editor_.handles().size()) + " handles",
            error};
  }

  const Options& options_;
  deform::Deformer& deformer_;
  deform::ProjectedDeformer& projected_;
  const Asset& asset_;
  Publisher& publisher_;
  Camera camera_;
  Editor editor_;
  Hand hand_;
  LocalSurface local_;
  SendPace pace_;
  GlfwWindow window_{kInstead};
  std::unique_ptr<Painter> painter_;
  int width_ = 0, height_ = 0;
  bool redraw_ = true, received_ = false, cage_ = true, edges_ = false, figures_ = true, help_ = false, quit_ = false;
  std::optional<TimeUs> input_us_;       ///< For the newest event without a pose.
  std::optional<TimeUs> pose_input_us_;  ///< For the event that made the pose.
  bool unsent_ = false;                  ///< The pose by hand has not been sent.
  std::vector<Vec3> posed_;              ///< The handles of y_ and C_.
  std::vector<double> y_, C_;
  std::uint64_t pose_ = 0;
  std::shared_ptr<const SurfaceGeometry> surface_;
  std::uint64_t surface_pose_ = 0;  ///< What surface_ shows.
  bool surface_received_ = false;   ///< Likewise.
  TimeUs shown_us_ = 0;
  Report report_;
};

}  // namespace

Result<void> find_display() {
  return GlfwWindow(kInstead).start();
}

Result<Report> run(const Options& options, deform::Deformer& deformer, deform::ProjectedDeformer& projected,
                   const Asset& asset, Publisher& publisher, const std::function<bool()>& stop, const LogSink& log) {
  Studio studio(options, deformer, projected, asset, publisher);
  if (const Result<void> opened = studio.open(log); !opened) return opened.error();
  if (const Result<void> ran = studio.run(stop); !ran) return ran.error();
  return studio.report();
}

}  // namespace eigencast::studio
