// SPDX-License-Identifier: MIT
#include "client/session.h"

#include <algorithm>
#include <cassert>
#include <nlohmann/json.hpp>
#include <thread>
#include <utility>

#include "common/asset/detail.h"
#include "common/core/text.h"

namespace eigencast {
namespace {

using nlohmann::json;

json json_from(const Histogram& h) {
  return {{"count", h.count()},      {"p50", h.percentile(50)}, {"p90", h.percentile(90)},
          {"p99", h.percentile(99)}, {"max", h.max()},          {"negative", h.negative()}};
}

json json_from(const std::optional<TimeUs>& value) {
  return value ? json(*value) : json(nullptr);
}

bool is_well(Subscriber::State state) {
  return state == Subscriber::State::kLive || state == Subscriber::State::kDownloading;
}

std::vector<Placement> one_each(std::size_t sources) {
  std::vector<Placement> placements(sources);
  for (std::size_t i = 0; i < sources; ++i) placements[i].source = i;
  return placements;
}

double per_second(std::uint64_t count, double seconds) {
  return seconds > 0 ? static_cast<double>(count) / seconds : 0;
}

}  // namespace

Session::Session(const ClientOptions& options, std::span<PoseSource* const> sources, LogSink log)
    : options_(options),
      sources_(sources.begin(), sources.end()),
      log_(std::move(log)),
      scene_(options.scene.placements.empty() ? one_each(sources.size()) : options.scene.placements,
             options.view_options, options.scene.row),
      levels_(options.levels),
      colours_(options.headless ? Decode::kNow : Decode::kBeside),
      pixel_scale_(options.ui_scale > 0 ? static_cast<float>(options.ui_scale) : 1),
      started_us_(steady_now_us()),
      said_(sources.size()) {
  for (std::size_t i = 0; i < sources.size(); ++i)
    names_.push_back(i < options.scene.streams.size() ? options.scene.streams[i] : "");
  for (const Placement& placement : options.scene.placements) assert(placement.source < sources.size());
}

Result<std::unique_ptr<Session>> Session::create(const ClientOptions& options, std::span<PoseSource* const> sources,
                                                 LogSink log) {
  std::unique_ptr<Session> session(new Session(options, sources, std::move(log)));
  if (const Result<void> opened = session->record_.open(options.record, options.record_shown); !opened)
    return opened.error();
  return session;
}

void Session::rebuild_with(const RebuilderChoice& choice) {
  scene_.set_rebuilder(choice.card.get());
  rebuild_trial_ = choice.trial;
  std::string line = std::string("surfaces are rebuilt on the ") + (choice.card ? "graphics card" : "processor");
  if (choice.trial) {
    line += formatted(": a trial took %.1f ms there and %.1f ms on the other",
                      static_cast<double>(choice.card ? choice.trial->gpu_us : choice.trial->cpu_us) / 1000,
                      static_cast<double>(choice.card ? choice.trial->cpu_us : choice.trial->gpu_us) / 1000);
  }
  log(log_, LogLevel::kInfo, line);
}

void Session::add(PoseSource& source, const std::string& name, Placement placement) {
  auto at = std::find(sources_.begin(), sources_.end(), &source);
  placement.source = static_cast<std::size_t>(at - sources_.begin());
  if (at == sources_.end()) {
    sources_.push_back(&source);
    names_.push_back(name);
    said_.emplace_back();
  }
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
  const auto at = static_cast<std::ptrdiff_t>(source);
  PoseSource* gone = sources_[source];
  sources_.erase(sources_.begin() + at);
  names_.erase(names_.begin() + at);
  said_.erase(said_.begin() + at);
  return gone;
}

std::string Session::name_of_surface(std::size_t surface) const {
  const Placement& placement = scene_.instances()[surface].placement;
  if (!placement.name.empty()) return placement.name;
  const auto& info = sources_[placement.source]->info();
  return info && !info->stream.empty() ? info->stream : names_[placement.source];
}

bool Session::poll(std::chrono::milliseconds timeout) {
  if (sources_.empty()) {
    std::this_thread::sleep_for(timeout);
    return false;
  }
  bool received = false;
  const auto share = timeout / static_cast<int>(sources_.size());
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    const std::vector<ReceivedPose> poses = sources_[i]->poll(received ? std::chrono::milliseconds(0) : share);
    received |= !poses.empty();
    for (const ReceivedPose& pose : poses) {
      last_arrival_us_ = std::max(last_arrival_us_, pose.arrival_us);
      decode_us_.add(pose.decoded_us - pose.arrival_us);
    }
    poses_taken_ += poses.size();
    record_.received(i, poses);
    scene_.receive(i, *sources_[i], poses);
  }
  return received;
}

bool Session::update(std::chrono::milliseconds timeout, Camera& camera) {
  const bool received = poll(timeout);
  const TimeUs now = steady_now_us();
  work_.start(now);
  levels_.choose(scene_, sources_, camera, std::exchange(last_work_, std::nullopt));
  const bool changed = scene_.advance(sources_, now);
  frame_scene(camera);
  const Subscriber::Stats stats = this->stats();
  if (received) {
    last_ = Received{last_arrival_us_, stats.keys, stats.bytes, poses_taken_};
    if (!first_) first_ = last_;
  }
  keys_.sample(stats.keys, now);
  poses_.sample(poses_taken_, now);
  bytes_.sample(stats.bytes, now);
  drawn_rate_.sample(drawn_, now);
  if (is_connected()) {
    lost_since_us_.reset();
  } else if (!lost_since_us_) {
    lost_since_us_ = now;
  }
  say_states();
  remember(now);
  work_.stop(steady_now_us());
  return changed;
}

void Session::remember(TimeUs now_us) {
  std::uint64_t all = 0;
  for (const Scene::Instance& instance : scene_.instances()) {
    const Asset* asset = sources_[instance.placement.source]->asset();
    all += asset == nullptr ? 0 : asset->vertex_count;
  }
  HistorySample sample;
  sample.lod = all == 0 ? 0 : static_cast<double>(scene_.vertex_count()) / static_cast<double>(all);
  sample.drawn_hz = drawn_rate_.per_second();
  sample.control = levels_.state();
  sample.latency_ms = static_cast<double>(last_latency_us_) / 1000;
  sample.kbit_per_s = bytes_.per_second() * 8 / 1000;
  history_.add(sample, now_us);
}

void Session::say_states() {
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    const Subscriber::Stats stats = sources_[i]->stats();
    if (said_[i] == stats.state) continue;  // the source itself says why and when it tries again
    said_[i] = stats.state;
    std::string line(name_of(stats.state));
    if (sources_.size() > 1) line = names_[i] + ": " + line;
    if (!stats.detail.empty()) line += ": " + stats.detail;
    const bool fine = is_well(stats.state) || stats.state == Subscriber::State::kConnecting ||
                      stats.state == Subscriber::State::kWaiting;
    log(log_, fine ? LogLevel::kInfo : LogLevel::kWarning, line);
  }
}

void Session::frame_scene(Camera& camera) {
  const SurfaceFacts& facts = scene_.facts();
  if (facts.version == facts_version_) return;
  facts_version_ = facts.version;
  if (!up_set_ && facts.up_axis != Asset::UpAxis::kUnknown) {
    up_set_ = true;  // once: afterwards the user's choice stands
    camera.set_up(facts.up_axis == Asset::UpAxis::kX   ? Camera::Up::kX
                  : facts.up_axis == Asset::UpAxis::kZ ? Camera::Up::kZ
                                                       : Camera::Up::kY);
  }
  camera.set_scene({facts.low[0], facts.low[1], facts.low[2]}, {facts.high[0], facts.high[1], facts.high[2]});
}

RenderOptions Session::render_options(const Look& look) const {
  RenderOptions options;
  options.edges = look.edges;
  options.wireframe = look.wireframe;
  options.points = look.points;
  options.axes = look.axes;
  options.grid = look.grid;
  options.transparent = look.transparent;
  options.colourfulness = colourfulness();
  options.pixel_scale = pixel_scale_;
  options.colour_map = look.colour_map;
  options.colour_range = colours_.range(look);
  return options;
}

std::optional<Legend> Session::legend() const {
  return colours_.legend(sources_.empty() ? nullptr : sources_.front()->asset());
}

void Session::draw(Renderer& renderer, const Camera& camera, const Look& look, int width_px, int height_px,
                   unsigned target) {
  const TimeUs start = steady_now_us();
  work_.start(start);
  const auto& instances = scene_.instances();
  if (std::exchange(renderer_stale_, false)) renderer.set_surface_count(0);
  renderer.set_surface_count(instances.size());
  for (std::size_t i = 0; i < instances.size(); ++i) {
    renderer.upload(i, instances[i].view.geometry());
    renderer.place(i, instances[i].scene_from_surface, instances[i].visible);
  }
  colours_.paint(scene_, sources_, look, renderer);
  uploaded_us_ = steady_now_us();
  upload_us_.add(uploaded_us_ - start);
  renderer.draw(camera, render_options(look), width_px, height_px, target);
}

void Session::finish_picture(bool wait) {
  if (wait || levels_.active()) Renderer::finish();
  const TimeUs end = steady_now_us();
  draw_us_.add(end - uploaded_us_);
  work_.stop(end);
  const TimeUs work = work_.take();
  work_us_.add(work);
  last_work_ = FrameWork{end, static_cast<double>(work) / 1e6};
  ++drawn_;
  record_.shown(scene_, end);
  if (scene_.poses_shown() == drawn_pose_) return;
  drawn_pose_ = scene_.poses_shown();
  TimeUs newest = 0;
  for (const Scene::Instance& instance : scene_.instances())
    newest = std::max(newest, instance.view.shown_capture_us().value_or(0));
  if (newest == 0) return;
  last_latency_us_ = end - newest;
  drawn_latency_us_.add(last_latency_us_);
}

Subscriber::Stats Session::stats() const {
  if (sources_.empty()) return {};
  Subscriber::Stats all = troubled().stats();
  for (const PoseSource* source : sources_) {
    if (source == &troubled()) continue;
    const Subscriber::Stats s = source->stats();
    all.keys += s.keys;
    all.synthetic += s.synthetic;
    all.joins += s.joins;
    all.bytes += s.bytes;
    all.rejected += s.rejected;
    all.skipped += s.skipped;
    all.missed += s.missed;
    all.reconnects += s.reconnects;
    all.asset_bytes_downloaded += s.asset_bytes_downloaded;
    all.asset_bytes_cached += s.asset_bytes_cached;
    all.asset_bytes_total += s.asset_bytes_total;
    all.latency_us.merge(s.latency_us);
  }
  return all;
}

const PoseSource& Session::troubled() const {
  for (const PoseSource* source : sources_) {
    if (!is_well(source->stats().state)) return *source;
  }
  return *sources_.front();
}

std::optional<TimeUs> Session::newest_arrival_us() const {
  std::optional<TimeUs> newest;
  for (const Scene::Instance& instance : scene_.instances())
    newest = std::max(newest, instance.view.newest_arrival_us());
  return newest;
}

bool Session::is_connected() const {
  return sources_.empty() || is_well(troubled().stats().state);
}

float Session::colourfulness() const {
  if (!lost_since_us_ || !newest_arrival_us()) return 1;
  return std::clamp(1 - static_cast<float>(steady_now_us() - *lost_since_us_) / 500'000.0F, 0.0F, 1.0F);
}

HudFigures Session::figures() const {
  HudFigures f;
  f.keys_hz = keys_.per_second();
  f.poses_hz = poses_.per_second();
  f.drawn_hz = drawn_rate_.per_second();
  f.kbit_per_s = bytes_.per_second() * 8 / 1000;
  const Subscriber::Stats stats = this->stats();
  f.latency_p50_us = stats.latency_us.percentile(50);
  f.latency_p99_us = stats.latency_us.percentile(99);
  f.latency_count = stats.latency_us.count();
  f.vertices = scene_.vertex_count();
  f.faces = scene_.triangle_count();
  for (const Scene::Instance& instance : scene_.instances()) {
    const Asset* asset = sources_[instance.placement.source]->asset();
    if (asset == nullptr) continue;
    f.vertices_total += asset->vertex_count;
    f.levels.push_back(static_cast<double>(instance.view.geometry().vertex_count()) / asset->vertex_count);
  }
  if (scene_.instances().empty()) return f;
  const SurfaceView& first = scene_.instances().front().view;
  const PoseSource& source = *sources_[scene_.instances().front().placement.source];
  f.bands = first.bands_received();
  if (const Asset* asset = source.asset()) {
    f.rank = asset->rank;
    f.bands_total = static_cast<std::uint32_t>(asset->band_ends.size());
  }
  const auto& instances = scene_.instances();
  f.rebuilt = text_from_rebuilt(static_cast<std::size_t>(std::count_if(
                                    instances.begin(), instances.end(),
                                    [](const auto& instance) { return instance.view.geometry().card != nullptr; })),
                                instances.size());
  if (levels_.active()) f.resolver = text_from_levels(levels_, static_cast<double>(work_us_.percentile(50)) / 1e6);
  f.shown = text_from_shown(first.shown(), first.settling(), first.playout());
  f.mode = text_from_mode(source.info() ? source.info()->profile : options_.profile.value_or(Profile{}));
  return f;
}

std::string Session::connection() const {
  if (sources_.empty()) return {};
  return connection_line(stats(), troubled().info());
}

std::string Session::banner() const {
  if (sources_.empty()) return {};
  std::optional<TimeUs> since;
  if (newest_arrival_us()) since = steady_now_us() - *newest_arrival_us();
  return banner_text(stats(), since);
}

json Session::surfaces_report() const {
  json surfaces = json::array();
  for (const Scene::Instance& instance : scene_.instances()) {
    const PoseSource& source = *sources_[instance.placement.source];
    const Asset* asset = source.asset();
    const SurfaceView& view = instance.view;
    surfaces.push_back({{"stream", instance.placement.source},
                        {"name", instance.placement.name},
                        {"state", name_of(source.stats().state)},
                        {"poses_shown", view.poses_shown()},
                        {"vertices", view.geometry().vertex_count()},
                        {"of", asset == nullptr ? 0 : asset->vertex_count},
                        {"faces", view.geometry().triangles.size() / 3},
                        {"rebuilt", view.geometry().card ? "gpu" : "cpu"},
                        {"detail", asset == nullptr ? "none" : name_of(detail_of(*asset))}});
  }
  return surfaces;
}

std::string Session::report(const Renderer& renderer, int width_px, int height_px) const {
  const Subscriber::Stats stats = this->stats();
  const HudFigures figures_now = figures();
  if (scene_.instances().empty())
    return json{{"program", "eigencast-client " EIGENCAST_VERSION}, {"surfaces", json::array()}}.dump(2) + "\n";
  const PoseSource& source = *sources_[scene_.instances().front().placement.source];
  const SurfaceView& view = scene_.instances().front().view;
  std::uint64_t unusable = 0;
  for (const Scene::Instance& instance : scene_.instances()) unusable += instance.view.poses_unusable();
  // Rates are those between the first and the last arrival, with the counters as they stood at both.
  const Received first = first_.value_or(Received{}), last = last_.value_or(Received{});
  const double span_s = static_cast<double>(last.arrival_us - first.arrival_us) / 1e6;
  const auto& info = source.info();
  json report;
  report["program"] = "eigencast-client " EIGENCAST_VERSION;
  report["url"] = options_.scene.streams.empty() ? "" : options_.scene.streams.front();
  report["stream"] = info ? info->stream : "";
  report["asset"] = info ? info->asset : "";
  report["mode"] = figures_now.mode;
  report["state"] = name_of(stats.state);
  report["duration_s"] = static_cast<double>(steady_now_us() - started_us_) / 1e6;
  report["receiving_s"] = span_s;
  report["frames_in"] = {{"keys", stats.keys},         {"synthetic", stats.synthetic}, {"joins", stats.joins},
                         {"poses", poses_taken_},      {"bytes", stats.bytes},         {"missed", stats.missed},
                         {"rejected", stats.rejected}, {"unusable", unusable}};
  report["frames_out"] = {{"drawn", drawn_}, {"poses_shown", scene_.poses_shown()}, {"written", written_}};
  report["rates_hz"] = {{"keys", per_second(last.keys - first.keys, span_s)},
                        {"poses", per_second(last.poses - first.poses, span_s)},
                        {"drawn", per_second(drawn_, span_s)}};
  report["kbit_per_s"] = per_second((last.bytes - first.bytes) * 8, span_s) / 1000;
  report["latency_us"] = {{"arrival", json_from(stats.latency_us)}, {"drawn", json_from(drawn_latency_us_)}};
  report["lod"] = {{"fraction", scene_.lod().fraction()},
                   {"vertices", figures_now.vertices},
                   {"of", figures_now.vertices_total},
                   {"faces", figures_now.faces},
                   {"resolver", name_of(levels_.kind())},
                   {"target_fps", levels_.active() ? json(levels_.settings().target_fps) : json(nullptr)},
                   {"state", levels_.active() ? json(levels_.state()) : json(nullptr)}};
  report["surfaces"] = surfaces_report();
  report["reconstruct"] = {
      {"asked", name_of(options_.reconstruct)},
      {"trial_us",
       rebuild_trial_ ? json{{"cpu", rebuild_trial_->cpu_us}, {"gpu", rebuild_trial_->gpu_us}} : json(nullptr)}};
  report["bands"] = {{"received", figures_now.bands}, {"of", figures_now.bands_total}, {"rank", figures_now.rank}};
  const Playout& playout = view.playout();
  report["playout"] = {{"mode", name_of(playout.settings().mode)},
                       {"smoothness", playout.smoothness()},
                       {"delay_us", playout.delay_us()}};
  for (std::size_t i = 0; i < view.times_shown().size(); ++i)
    report["playout"]["shown"][std::string(name_of(static_cast<Shown>(i)))] = view.times_shown()[i];
  if (const Asset* asset = source.asset()) report["surface"] = {{"area", asset->area}, {"diagonal", asset->diagonal()}};
  report["reconnects"] = stats.reconnects;
  report["clock"] = {{"offset_us", json_from(stats.clock_offset_us)},
                     {"error_us", json_from(stats.clock_error_us)},
                     {"rtt_us", json_from(stats.rtt_us)}};
  report["asset_bytes"] = {{"downloaded", stats.asset_bytes_downloaded},
                           {"cached", stats.asset_bytes_cached},
                           {"total", stats.asset_bytes_total}};
  report["frame_time_us"] = {{"decode", json_from(decode_us_)},
                             {"reconstruct", json_from(scene_.reconstruct_us())},
                             {"normals", json_from(scene_.normals_us())},
                             {"upload", json_from(upload_us_)},
                             {"draw", json_from(draw_us_)},
                             {"work", json_from(work_us_)}};
  report["picture"] = {
      {"width", width_px}, {"height", height_px}, {"samples", renderer.samples()}, {"device", renderer.device()}};
  return report.dump(2) + "\n";
}

}  // namespace eigencast
