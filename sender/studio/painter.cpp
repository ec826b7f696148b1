// SPDX-License-Identifier: MIT
#include "sender/studio/painter.h"

#include <algorithm>
#include <condition_variable>
#include <exception>
#include <future>
#include <glm/ext/matrix_transform.hpp>
#include <mutex>
#include <thread>

#include "common/net/guarded_run.h"
#include "view/scene.h"

namespace eigencast::studio {
namespace {

constexpr auto kPollInterval = std::chrono::milliseconds(4);
constexpr auto kIdle = std::chrono::milliseconds(250);
constexpr float kGap = 0.12F;  // between one's own surface and those of others, of its width

std::vector<Placement> placements_of(const std::vector<std::string>& names) {
  std::vector<Placement> placements;
  for (std::size_t i = 0; i < names.size(); ++i) placements.push_back({i, names[i], glm::mat4(1)});
  return placements;
}

}  // namespace

class Painter::Impl {
 public:
  explicit Impl(Options options) : options_(std::move(options)), scene_(placements_of(options_.names), {}, true) {
    for (const auto& source : options_.others) sources_.push_back(source.get());
  }

  Result<void> start() {
    std::promise<Result<void>> ready;
    std::future<Result<void>> opened = ready.get_future();
    thread_ = std::thread([this, &ready] { run(ready); });
    return opened.get();
  }
  void stop() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    changed_.notify_one();
    if (thread_.joinable()) thread_.join();
  }
  void show(Picturing state) {
    {
      const std::lock_guard lock(mutex_);
      // A pose that nobody saw is as old as the hand that made it.
      if (wanted_ && wanted_->input_us && state.pose == wanted_->pose) state.input_us = wanted_->input_us;
      wanted_ = std::move(state);
    }
    changed_.notify_one();
  }
  std::optional<std::pair<glm::vec3, glm::vec3>> take_box() {
    const std::lock_guard lock(mutex_);
    return std::exchange(box_, std::nullopt);
  }
  PaintingReport report() const {
    const std::lock_guard lock(mutex_);
    return report_;
  }

 private:
  void run(std::promise<Result<void>>& ready) {
    options_.window->make_current();
    const Result<void> opened = open();
    ready.set_value(opened);
    // What cannot be drawn (memory ran out) does not end what a hand is deforming: the next state perhaps can be.
    const auto failed = [this](const std::string& what) { log(options_.log, LogLevel::kError, "drawing: " + what); };
    if (opened) guarded_run([this] { draw_until_stopped(); }, failed);
    overlay_.reset();
    renderer_.reset();
    GlfwWindow::release_current();
  }

  Result<void> open() {
    try {
      Result<std::unique_ptr<Renderer>> renderer = Renderer::create();
      if (!renderer) return renderer.error();
      renderer_ = std::move(*renderer);
      renderer_->set_surface_count(1 + sources_.size());
      overlay_ = std::make_unique<Overlay>(nullptr, TextScale{options_.scale, 1});
      report_.device = renderer_->device();
      return {};
    } catch (const std::exception& error) {
      return fail(ErrorCode::kInternal, std::string("the window cannot draw: ") + error.what());
    }
  }

  void draw_until_stopped() {
    while (wait()) turn();
  }

  /// Until there may be something to draw; takes the newest state. False when it is over.
  bool wait() {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, sources_.empty() ? kIdle : kPollInterval, [&] { return stopping_ || wanted_.has_value(); });
    has_news_ = wanted_.has_value();
    if (wanted_) state_ = *std::exchange(wanted_, std::nullopt);
    return !stopping_;
  }

  void turn() {
    const bool others_moved = take_others();
    if (state_.width_px < 1 || state_.height_px < 1 || (!has_news_ && !others_moved)) return;
    if (state_.surface) renderer_->upload(0, *state_.surface);
    draw();
    Renderer::finish();
    const TimeUs drawn_us = steady_now_us();
    options_.window->swap();
    const std::lock_guard lock(mutex_);
    ++report_.pictures;
    if (state_.pose != drawn_pose_ && state_.input_us) report_.input_to_drawn_us.add(drawn_us - *state_.input_us);
    drawn_pose_ = state_.pose;
  }

  bool take_others() {
    if (sources_.empty()) return false;
    for (std::size_t i = 0; i < sources_.size(); ++i) {
      const std::vector<ReceivedPose> poses = sources_[i]->poll(std::chrono::milliseconds(0));
      scene_.receive(i, *sources_[i], poses);
    }
    if (!scene_.advance(sources_, steady_now_us())) return false;
    if (scene_.facts().version != box_version_) place_others();
    for (std::size_t i = 0; i < scene_.instances().size(); ++i) {
      const Scene::Instance& other = scene_.instances()[i];
      renderer_->upload(1 + i, other.view.geometry());
      renderer_->place(1 + i, beside_ * other.scene_from_surface, other.visible);
    }
    const std::lock_guard lock(mutex_);
    report_.others_poses = scene_.poses_shown();
    return true;
  }

  /// In a row that begins beside one's own surface.
  void place_others() {
    const SurfaceFacts& facts = scene_.facts();
    box_version_ = facts.version;
    const glm::vec3 low(facts.low[0], facts.low[1], facts.low[2]), high(facts.high[0], facts.high[1], facts.high[2]);
    const float aside = options_.high.x + kGap * (options_.high.x - options_.low.x) - low.x;
    beside_ = glm::translate(glm::mat4(1), {aside, 0, 0});
    log(options_.log, LogLevel::kDebug,
        std::to_string(scene_.vertex_count()) + " vertices of others stand beside the model");
    const glm::vec3 shift(aside, 0, 0);
    const std::lock_guard lock(mutex_);
    box_.emplace(glm::min(options_.low, low + shift), glm::max(options_.high, high + shift));
  }

  void draw() {
    renderer_->mark(state_.markup);
    renderer_->draw(state_.camera, state_.options, state_.width_px, state_.height_px, 0);
    OverlayContent content;
    if (!state_.figures.empty()) content.figures = figures();
    content.connection = state_.connection;
    content.connected = state_.connected;
    content.help = state_.help;
    overlay_->draw(content, state_.width_px, state_.height_px, 0);
  }

  std::vector<std::string> figures() const {
    std::vector<std::string> lines = state_.figures;
    for (std::size_t i = 0; i < sources_.size(); ++i) {
      const Subscriber::Stats stats = sources_[i]->stats();
      const bool live = stats.state == Subscriber::State::kLive;
      lines.push_back(options_.names[i] +
                      (live ? ": live, " + std::to_string(stats.keys) + " keys" : ": " + stats.detail));
    }
    return lines;
  }

  Options options_;
  std::vector<PoseSource*> sources_;
  Scene scene_;
  glm::mat4 beside_{1};
  std::uint64_t box_version_ = 0, drawn_pose_ = 0;
  std::unique_ptr<Renderer> renderer_;
  std::unique_ptr<Overlay> overlay_;
  Picturing state_;
  bool has_news_ = false;
  std::thread thread_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // Guarded by mutex_:
  bool stopping_ = false;
  std::optional<Picturing> wanted_;
  std::optional<std::pair<glm::vec3, glm::vec3>> box_;
  PaintingReport report_;
};

Painter::Painter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Painter::~Painter() {
  impl_->stop();
}

Result<std::unique_ptr<Painter>> Painter::start(Options options) {
  auto impl = std::make_unique<Impl>(std::move(options));
  Impl& started = *impl;
  std::unique_ptr<Painter> painter(new Painter(std::move(impl)));
  if (const Result<void> ready = started.start(); !ready) return ready.error();
  return painter;
}

void Painter::show(Picturing state) {
  impl_->show(std::move(state));
}
std::optional<std::pair<glm::vec3, glm::vec3>> Painter::take_box() {
  return impl_->take_box();
}
PaintingReport Painter::report() const {
  return impl_->report();
}

}  // namespace eigencast::studio
