// SPDX-License-Identifier: MIT
#include "client/session.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>
#include <thread>
#include <utility>

#include "client/clip_source.h"
#include "common/core/text.h"
#include "common/wire/link_bytes.h"

namespace eigencast {
namespace {

std::vector<Placement> one_each(std::size_t sources) {
  std::vector<Placement> placements(sources);
  for (std::size_t i = 0; i < sources; ++i) placements[i].source = i;
  return placements;
}

}  // namespace

std::optional<TimeUs> utc_shown(const SurfaceView& view, const PoseSource& source) {
  const auto shown_us = view.shown_capture_us();
  const bool is_new = source.info() && source.epoch() == source.info()->epoch;
  return shown_us && is_new ? std::optional(source.utc_us(*shown_us)) : std::nullopt;
}

Session::Session(const ClientOptions& options, std::span<PoseSource* const> sources, LogSink log)
    : options_(options),
      connections_(sources, options.scene.streams, log),
      log_(std::move(log)),
      scene_(options.scene.placements.empty() ? one_each(sources.size()) : options.scene.placements,
             options.view_options, options.scene.row),
      levels_(options.levels),
      colours_(options.headless ? Decode::kNow : Decode::kBackground),
      pixel_scale_(options.ui_scale > 0 ? static_cast<float>(options.ui_scale) : 1),
      started_us_(steady_now_us()) {
  scene_.set_shading(options.style);
  if (options.ago_s > 0) rewind_.begin(options.ago_s, options.speed);
  assert(std::all_of(options.scene.placements.begin(), options.scene.placements.end(),
                     [&](const Placement& placement) { return placement.source < sources.size(); }));
}

Result<std::unique_ptr<Session>> Session::create(const ClientOptions& options, std::span<PoseSource* const> sources,
                                                 LogSink log) {
  std::unique_ptr<Session> session(new Session(options, sources, std::move(log)));
  if (const Result<void> opened = session->record_.open(options.record, options.record_shown); !opened)
    return opened.error();
  if (options.room.empty()) return session;
  const auto& streams = options.scene.streams;
  const auto first = std::find_if(streams.begin(), streams.end(), [](const std::string& s) { return !clip_in(s); });
  const auto index = static_cast<std::size_t>(first - streams.begin());
  if (index >= options.credentials.size())
    return fail(ErrorCode::kInvalidArgument, "--room: name a stream of the broker whose room it is");
  auto entered = RoomClient::enter(*first, options.credentials[index],
                                   {options.room, options.person, colour_of_name(options.person)}, session->log_);
  if (!entered) return in_context("--room", entered.error());
  session->room_ = std::make_unique<RoomDesk>(std::move(*entered));
  return session;
}

std::vector<Label> Session::labels(const Camera& camera) const {
  std::vector<Label> labels;
  if (!room_) return labels;
  for (RoomDesk::Mark& mark : room_->marks(scene_, sources())) {
    const auto at = camera.pixel_from_scene(mark.at);
    if (at) labels.push_back({at->x, at->y, mark.colour, std::move(mark.text), mark.is_pin});
  }
  return labels;
}

void Session::rebuild_with(const RebuilderChoice& choice) {
  scene_.set_rebuilder(choice.gpu.get());
  rebuild_trial_ = choice.trial;
  std::string line = std::string("surfaces are rebuilt on the ") + (choice.gpu ? "GPU" : "processor");
  if (choice.trial) {
    line += formatted(": a trial took %.1f ms there and %.1f ms on the other",
                      static_cast<double>(choice.gpu ? choice.trial->gpu_us : choice.trial->cpu_us) / 1000,
                      static_cast<double>(choice.gpu ? choice.trial->cpu_us : choice.trial->gpu_us) / 1000);
  }
  log(log_, LogLevel::kInfo, line);
}

void Session::add(PoseSource& source, const std::string& name, Placement placement) {
  placement.source = connections_.add(source, name);
  scene_.add(std::move(placement));
}

PoseSource* Session::remove(std::size_t surface) {
  const std::size_t source = scene_.instances()[surface].placement.source;
  scene_.remove(surface);
  colours_.remove(surface);
  renderer_stale_ = true;
  auto& instances = scene_.instances();
  if (std::any_of(instances.begin(), instances.end(), [&](const auto& i) { return i.placement.source == source; }))
    return nullptr;
  for (Scene::Instance& instance : instances) instance.placement.source -= instance.placement.source > source ? 1 : 0;
  return connections_.remove(source);
}

std::string Session::name_of_surface(std::size_t surface) const {
  const Placement& placement = scene_.instances()[surface].placement;
  if (!placement.name.empty()) return placement.name;
  const auto& info = sources()[placement.source]->info();
  return info && !info->stream.empty() ? info->stream : connections_.name(placement.source);
}

bool Session::poll(std::chrono::milliseconds timeout) {
  if (sources().empty()) {
    std::this_thread::sleep_for(timeout);
    return false;
  }
  bool received = false;
  const auto share = timeout / static_cast<int>(sources().size());
  for (std::size_t i = 0; i < sources().size(); ++i) {
    const std::vector<ReceivedPose> poses = sources()[i]->poll(received ? std::chrono::milliseconds(0) : share);
    received |= !poses.empty();
    for (const ReceivedPose& pose : poses) {
      last_arrival_us_ = std::max(last_arrival_us_, pose.arrival_us);
      decode_us_.add(pose.decoded_us - pose.arrival_us);
    }
    poses_taken_ += poses.size();
    record_.received(i, poses);
    scene_.receive(i, *sources()[i], poses);
  }
  return received;
}

bool Session::update(std::chrono::milliseconds timeout, Camera& camera, std::optional<TimeUs> film_us) {
  const bool received = poll(timeout);
  work_.start(steady_now_us());
  const TimeUs now = film_us.value_or(steady_now_us());
  rewind_.advance(sources(), scene_, steady_now_us());
  const bool sharpens = look_still(camera, now);
  levels_.choose(scene_, sources(), camera, std::exchange(last_work_, std::nullopt));
  const bool moved = room_ && room_->advance(camera, now);
  if (room_) {
    room_->share(rewind_, sources());
    const std::string& trouble = room_->state().trouble;
    if (trouble != std::exchange(room_trouble_, trouble) && !trouble.empty())
      log(log_, LogLevel::kWarning, "--room: " + trouble);
  }
  const bool changed = scene_.advance(sources(), now) || sharpens || moved;
  frame_scene(camera);
  connections_.refresh(now);
  const Subscriber::Stats& stats = connections_.stats();
  if (received) {
    last_ = Received{last_arrival_us_, stats.keys, stats.frames, stats.bytes, poses_taken_};
    if (!first_) first_ = last_;
  }
  keys_.sample(stats.keys, now);
  poses_.sample(poses_taken_, now);
  bytes_.sample(stats.bytes, now);
  frames_.sample(stats.frames, now);
  recalled_.sample(stats.recalled, now);
  drawn_rate_.sample(drawn_, now);
  remember(now);
  work_.stop(steady_now_us());
  return changed;
}

bool Session::look_still(const Camera& camera, TimeUs now_us) {
  const Seen seen{scene_.moves(), camera.position(), camera.target()};
  return levels_.set_still(stillness_.look(std::exchange(seen_, seen) != seen, now_us));
}

double Session::drawn_part() const {
  std::uint64_t all = 0;
  for (const Scene::Instance& instance : scene_.instances()) {
    const Asset* asset = sources()[instance.placement.source]->asset();
    all += asset == nullptr ? 0 : asset->vertex_count;
  }
  return all == 0 ? 0 : static_cast<double>(scene_.vertex_count()) / static_cast<double>(all);
}

void Session::remember(TimeUs now_us) {
  HistorySample sample;
  sample.lod = drawn_part();
  sample.drawn_hz = drawn_rate_.per_second();
  sample.control = levels_.state();
  sample.latency_ms = static_cast<double>(last_latency_us_) / 1000;
  sample.kbit_per_s = bytes_.per_second() * 8 / 1000;
  history_.add(sample, now_us);
}

void Session::frame_scene(Camera& camera) {
  const SurfaceFacts& facts = scene_.facts();
  if (facts.version == facts_version_) return;
  facts_version_ = facts.version;
  if (!up_set_ && facts.up_axis != Asset::UpAxis::kUnknown) {
    up_set_ = true;  // once: then the user chooses
    camera.set_up(facts.up_axis == Asset::UpAxis::kX   ? Camera::Up::kX
                  : facts.up_axis == Asset::UpAxis::kZ ? Camera::Up::kZ
                                                       : Camera::Up::kY);
  }
  camera.set_scene(facts.low, facts.high, facts.outline);
}

void Session::draw(Renderer& renderer, const Camera& camera, const Style& style, int width_px, int height_px,
                   unsigned target) {
  const TimeUs start = steady_now_us();
  work_.start(start);
  const auto& instances = scene_.instances();
  if (std::exchange(renderer_stale_, false)) renderer.set_surface_count(0);
  renderer.set_surface_count(instances.size());
  for (std::size_t i = 0; i < instances.size(); ++i) {
    renderer.upload(i, instances[i].view.geometry());
    renderer.place(i, instances[i].scene_from_surface, instances[i].visible, colourfulness(instances[i], start));
  }
  colours_.update(scene_, sources(), style, Renderer::max_texture_side());
  colours_.upload(renderer);
  uploaded_us_ = steady_now_us();
  upload_us_.add(uploaded_us_ - start);
  RenderOptions options = render_options(style);
  options.quality = levels_.quality();
  renderer.draw(camera, options, width_px, height_px, target);
  const std::optional<PictureQuality> other = levels_.trial();
  if (!other) return;
  try_quality(renderer, camera, options, *other, width_px, height_px, target);
}

/// Beside the picture's work. Both are drawn twice in turn, counting the picture itself, for another program may delay
/// any.
void Session::try_quality(Renderer& renderer, const Camera& camera, RenderOptions options, const PictureQuality& other,
                          int width_px, int height_px, unsigned target) {
  Renderer::finish();
  const TimeUs drawn = steady_now_us();
  work_.stop(drawn);
  const Picture shown = Renderer::read_back(width_px, height_px, target);
  const unsigned aside = renderer.offscreen_target(width_px, height_px, true);
  const auto time_of = [&](const PictureQuality& quality) {
    options.quality = quality;
    const TimeUs began = steady_now_us();
    renderer.draw(camera, options, width_px, height_px, aside);
    Renderer::finish();
    return static_cast<double>(steady_now_us() - began);
  };
  const PictureQuality now = options.quality;
  const auto shown_us = static_cast<double>(drawn - uploaded_us_);
  const double before = static_cast<double>(work_.spent_us()) - shown_us;
  double others = time_of(other);  // makes buffers and programs, too
  const double own = std::min(shown_us, time_of(now));
  others = std::min(others, time_of(other));
  const Picture tried = Renderer::read_back(width_px, height_px, aside);
  double difference = 0;
  for (std::size_t i = 0; i < shown.rgb.size(); ++i) difference += std::abs(int{shown.rgb[i]} - int{tried.rgb[i]});
  levels_.measured(before + own, before + others,
                   difference / static_cast<double>(std::max<std::size_t>(shown.rgb.size(), 1)));
  const TimeUs end = steady_now_us();
  uploaded_us_ += end - drawn;
  work_.start(end);
}

void Session::finish_picture(bool wait) {
  if (wait || levels_.active()) Renderer::finish();
  const TimeUs end = steady_now_us();
  draw_us_.add(end - uploaded_us_);
  work_.stop(end);
  const TimeUs work = work_.take();
  work_us_.add(work);
  last_work_ = FrameWork{end, static_cast<double>(work) / 1e6};
  if (levels_.lowered()) {
    used_permille_.add(std::llround(static_cast<double>(work) * levels_.target_fps() / 1e3));
    drawn_permille_.add(std::llround(1e3 * drawn_part()));
  }
  ++drawn_;
  record_.shown(scene_, sources(), end);
  if (const auto sought_us = rewind_.take_sought(sources(), scene_)) seek_us_.add(end - *sought_us);
  if (scene_.poses_shown() == drawn_pose_) return;
  drawn_pose_ = scene_.poses_shown();
  TimeUs newest = 0;
  for (const Scene::Instance& instance : scene_.instances())
    newest = std::max(newest, instance.view.shown_capture_us().value_or(0));
  if (newest == 0 || rewind_.past_us()) return;
  last_latency_us_ = end - newest;
  drawn_latency_us_.add(last_latency_us_);
}

std::optional<TimeUs> Session::newest_arrival_us(std::size_t source) const {
  std::optional<TimeUs> newest;
  for (const Scene::Instance& instance : scene_.instances()) {
    if (instance.placement.source == source) newest = std::max(newest, instance.view.newest_arrival_us());
  }
  return newest;
}

float Session::colourfulness(const Scene::Instance& instance, TimeUs now_us) const {
  const std::optional<TimeUs>& since = connections_.lost_since_us(instance.placement.source);
  if (!since || !instance.view.newest_arrival_us()) return 1;
  return std::clamp(1 - static_cast<float>(now_us - *since) / 500'000.0F, 0.0F, 1.0F);
}

bool Session::is_fading() const {
  const TimeUs now = steady_now_us();
  const auto& all = scene_.instances();
  return std::any_of(all.begin(), all.end(), [&](const Scene::Instance& instance) {
    return connections_.lost_since_us(instance.placement.source) && instance.view.newest_arrival_us() &&
           colourfulness(instance, now) > 0;
  });
}

float Session::colourfulness() const {
  const TimeUs now = steady_now_us();
  float sum = 0;
  for (const Scene::Instance& instance : scene_.instances()) sum += colourfulness(instance, now);
  return scene_.instances().empty() ? 1 : sum / static_cast<float>(scene_.instances().size());
}

std::optional<TimeUs> Session::shown_utc_us() const {
  if (scene_.instances().empty()) return std::nullopt;
  const Scene::Instance& first = scene_.instances().front();
  return utc_shown(first.view, *sources()[first.placement.source]);
}

HudFigures Session::figures() const {
  HudFigures f;
  f.keys_hz = keys_.per_second();
  f.poses_hz = poses_.per_second();
  f.drawn_hz = drawn_rate_.per_second();
  f.kbit_per_s = bytes_.per_second() * 8 / 1000;
  const LinkBytes more = link_bytes(frames_.per_second(), bytes_.per_second());
  f.link_kbit_per_s = f.kbit_per_s + (more.websocket + more.tcp_ip) * 8 / 1000;
  f.tls_kbit_per_s = f.link_kbit_per_s + more.tls * 8 / 1000;
  const Subscriber::Stats& stats = connections_.stats();
  f.recalled = f.keys_hz > 0 ? std::min(1.0, recalled_.per_second() / f.keys_hz) : 0;
  f.memory_bytes = stats.memory_bytes;
  f.received = stats.bytes > 0;
  f.latency_p50_us = stats.latency_us.percentile(50);
  f.latency_p99_us = stats.latency_us.percentile(99);
  f.latency_count = stats.latency_us.count();
  f.vertices = scene_.vertex_count();
  f.faces = scene_.triangle_count();
  for (const Scene::Instance& instance : scene_.instances()) {
    const Asset* asset = sources()[instance.placement.source]->asset();
    if (asset == nullptr) continue;
    f.vertices_total += asset->vertex_count;
    f.vertices_wanted += instance.view.lod().vertices(*asset);
    f.levels.push_back(static_cast<double>(instance.view.geometry().vertex_count()) / asset->vertex_count);
  }
  if (scene_.instances().empty()) return f;
  const SurfaceView& first = scene_.instances().front().view;
  const PoseSource& source = *sources()[scene_.instances().front().placement.source];
  f.bands = first.bands_received();
  if (const Truth* truth = source.truth()) f.difference = truth->difference();
  if (const Asset* asset = source.asset()) {
    f.rank = asset->rank;
    f.bands_total = static_cast<std::uint32_t>(asset->band_ends.size());
  }
  const auto& instances = scene_.instances();
  f.rebuilt = text_from_rebuilt(static_cast<std::size_t>(std::count_if(
                                    instances.begin(), instances.end(),
                                    [](const auto& instance) { return instance.view.geometry().gpu != nullptr; })),
                                instances.size());
  if (levels_.active() || levels_.quality() != PictureQuality()) f.lowered = text_from_lowered(levels_, f);
  if (levels_.active()) f.resolver = text_from_levels(levels_, static_cast<double>(work_us_.percentile(50)) / 1e6);
  f.shown = text_from_shown(first.shown(), first.settling(), first.playout());
  if (const auto utc_us = shown_utc_us()) f.shown += " \xC2\xB7 " + timecode_of(*utc_us);
  f.mode = text_from_mode(source.info() ? source.info()->profile : options_.profile.value_or(Profile{}));
  return f;
}

OverlayContent Session::overlay_content() const {
  OverlayContent content;
  content.figures = hud_lines(figures());
  const Status now = status();
  content.connection = now.line;
  content.banner = now.banner;
  content.connected = connections_.are_well();
  content.legend = colours_.legend(sources().empty() ? nullptr : sources().front()->asset());
  return content;
}

Session::Status Session::status() const {
  std::optional<TimeUs> since;
  if (const auto newest = newest_arrival_us(connections_.troubled())) since = steady_now_us() - *newest;
  Status status;
  status.banner = connections_.banner(since);
  status.line = connections_.line(!status.banner.empty());
  constexpr std::string_view kLive = "live";
  if (rewind_.past_us() && status.line.starts_with(kLive))
    status.line.replace(0, kLive.size(), text_from_behind(rewind_.bar()->now_us - *rewind_.past_us()));
  if (status.banner.empty()) status.banner = colours_.why_not();
  return status;
}

}  // namespace eigencast
