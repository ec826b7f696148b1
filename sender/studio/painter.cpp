// SPDX-License-Identifier: MIT
#include "sender/studio/painter.h"

#include <exception>
#include <glm/ext/matrix_transform.hpp>

#include "common/net/guarded_run.h"

namespace eigencast::studio {
namespace {

constexpr auto kPollInterval = std::chrono::milliseconds(4);
constexpr auto kIdle = std::chrono::milliseconds(250);
constexpr float kGap = 0.12F;  // beside the user's surface, of its width

std::vector<Placement> placements_of(const std::vector<std::string>& names) {
  std::vector<Placement> placements;
  for (std::size_t i = 0; i < names.size(); ++i) placements.push_back({i, names[i], glm::mat4(1)});
  return placements;
}

}  // namespace

Painter::Painter(Options options) : options_(std::move(options)), scene_(placements_of(options_.names), {}, true) {
  for (const auto& source : options_.others) sources_.push_back(source.get());
}

Result<std::unique_ptr<Painter>> Painter::start(Options options) {
  std::unique_ptr<Painter> painter(new Painter(std::move(options)));
  std::promise<Result<void>> ready;
  std::future<Result<void>> opened = ready.get_future();
  painter->thread_ = std::thread([&painter = *painter, &ready] { painter.run(ready); });
  if (const Result<void> good = opened.get(); !good) return good.error();
  return painter;
}

Painter::~Painter() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_one();
  if (thread_.joinable()) thread_.join();
}

void Painter::show(Picturing state) {
  {
    const std::lock_guard lock(mutex_);
    // The age of a pose that was never drawn counts from its first input.
    if (wanted_ && wanted_->input_us && state.pose == wanted_->pose) state.input_us = wanted_->input_us;
    wanted_ = std::move(state);
  }
  changed_.notify_one();
}

std::optional<std::pair<glm::vec3, glm::vec3>> Painter::take_box() {
  const std::lock_guard lock(mutex_);
  return std::exchange(box_, std::nullopt);
}

PaintingReport Painter::report() const {
  const std::lock_guard lock(mutex_);
  return report_;
}

void Painter::run(std::promise<Result<void>>& ready) {
  options_.window->make_current();
  const Result<void> opened = open();
  ready.set_value(opened);
  // A state that cannot be drawn (out of memory) must not end the session: the next one may be.
  const auto failed = [this](const std::string& what) { log(options_.log, LogLevel::kError, "drawing: " + what); };
  const auto draw_until_stopped = [this] {
    while (wait()) turn();
  };
  if (opened) guarded_run(draw_until_stopped, failed);
  overlay_.reset();
  renderer_.reset();
  GlfwWindow::release_current();
}

Result<void> Painter::open() {
  try {
    if (const auto made = store(renderer_, Renderer::create()); !made) return made;
    renderer_->set_surface_count(1 + sources_.size());
    overlay_ = std::make_unique<Overlay>(nullptr, TextScale{options_.scale, 1});
    report_.device = renderer_->device();
    return {};
  } catch (const std::exception& error) {
    return fail(ErrorCode::kInternal, std::string("the window cannot draw: ") + error.what());
  }
}

/// False: the end.
bool Painter::wait() {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, sources_.empty() ? kIdle : kPollInterval, [&] { return stopping_ || wanted_.has_value(); });
  has_news_ = wanted_.has_value();
  if (wanted_) state_ = *std::exchange(wanted_, std::nullopt);
  return !stopping_;
}

void Painter::turn() {
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

bool Painter::take_others() {
  if (sources_.empty()) return false;
  for (std::size_t i = 0; i < sources_.size(); ++i)
    scene_.receive(i, *sources_[i], sources_[i]->poll(std::chrono::milliseconds(0)));
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

void Painter::place_others() {
  const SurfaceFacts& facts = scene_.facts();
  box_version_ = facts.version;
  const glm::vec3 shift(options_.high.x + kGap * (options_.high.x - options_.low.x) - facts.low.x, 0, 0);
  beside_ = glm::translate(glm::mat4(1), shift);
  log(options_.log, LogLevel::kDebug,
      std::to_string(scene_.vertex_count()) + " vertices of others stand beside the model");
  const std::lock_guard lock(mutex_);
  box_.emplace(glm::min(options_.low, facts.low + shift), glm::max(options_.high, facts.high + shift));
}

void Painter::draw() {
  renderer_->mark(state_.markup);
  renderer_->draw(state_.camera, state_.options, state_.width_px, state_.height_px, 0);
  OverlayContent content;
  if (!state_.figures.empty()) content.figures = figures();
  content.connection = state_.connection;
  content.connected = state_.connected;
  content.help = state_.help;
  overlay_->draw(content, state_.width_px, state_.height_px, 0);
}

std::vector<std::string> Painter::figures() const {
  std::vector<std::string> lines = state_.figures;
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    const Subscriber::Stats stats = sources_[i]->stats();
    const bool live = stats.state == Subscriber::State::kLive;
    lines.push_back(options_.names[i] +
                    (live ? ": live, " + std::to_string(stats.keys) + " keys" : ": " + stats.detail));
  }
  return lines;
}

}  // namespace eigencast::studio
