// SPDX-License-Identifier: MIT
#include "client/session.h"

#include <algorithm>
#include <nlohmann/json.hpp>

namespace eigencast {
namespace {

using nlohmann::json;

std::string_view name_of(FrameKind kind) {
  switch (kind) {
    case FrameKind::kKey:
      return "key";
    case FrameKind::kJoin:
      return "join";
    case FrameKind::kSynthetic:
      return "synthetic";
    case FrameKind::kStep:
      return "step";
    case FrameKind::kEstimate:
      return "estimate";
  }
  return "unknown";
}

json json_from(const Histogram& h) {
  return {{"count", h.count()},      {"p50", h.percentile(50)}, {"p90", h.percentile(90)},
          {"p99", h.percentile(99)}, {"max", h.max()},          {"negative", h.negative()}};
}

json json_from(const std::optional<TimeUs>& value) {
  return value ? json(*value) : json(nullptr);
}

double per_second(std::uint64_t count, double seconds) {
  return seconds > 0 ? static_cast<double>(count) / seconds : 0;
}

}  // namespace

Session::Session(const ClientOptions& options, PoseSource& source, LogSink log)
    : options_(options), source_(source), log_(std::move(log)), scene_(options.scene), started_us_(steady_now_us()) {}

Result<std::unique_ptr<Session>> Session::create(const ClientOptions& options, PoseSource& source, LogSink log) {
  std::unique_ptr<Session> session(new Session(options, source, std::move(log)));
  if (!options.record.empty()) {
    session->record_.open(options.record, std::ios::trunc);
    if (!session->record_) return fail(ErrorCode::kIo, options.record + ": cannot be written; is its folder there?");
  }
  if (!options.record_shown.empty()) {
    session->shown_record_.open(options.record_shown, std::ios::trunc);
    if (!session->shown_record_)
      return fail(ErrorCode::kIo, options.record_shown + ": cannot be written; is its folder there?");
  }
  return session;
}

bool Session::update(std::chrono::milliseconds timeout, Camera& camera) {
  std::vector<ReceivedPose> poses = source_.poll(timeout);
  const TimeUs now = steady_now_us();
  const bool received = !poses.empty();
  note_arrivals(poses);
  if (record_.is_open()) record(poses);
  scene_.receive(source_, std::move(poses));
  const bool changed = scene_.advance(source_, now);
  if (changed) frame_scene(camera);
  const Subscriber::Stats stats = source_.stats();
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
  say_state();
  return changed;
}

void Session::note_arrivals(const std::vector<ReceivedPose>& poses) {
  for (const ReceivedPose& pose : poses) {
    ++poses_taken_;
    last_arrival_us_ = pose.arrival_us;
  }
}

void Session::record(const std::vector<ReceivedPose>& poses) {
  for (const ReceivedPose& pose : poses) {
    const Envelope& e = pose.envelope;
    const json line{{"kind", name_of(e.kind)},
                    {"sequence", e.sequence},
                    {"at", e.step.at},
                    {"of", e.step.of},
                    {"epoch", e.epoch},
                    {"bands", e.bands},
                    {"ahead", (e.flags & Envelope::kAhead) != 0},
                    {"capture_us", e.capture_us},
                    {"arrival_us", pose.arrival_us},
                    {"channels", pose.channels},
                    {"coefficients", pose.coefficients}};
    record_ << line.dump() << '\n';
  }
  if (!poses.empty()) record_.flush();
}

void Session::record_shown(TimeUs drawn_us) {
  const json line{{"drawn_us", drawn_us},
                  {"capture_us", *scene_.shown_capture_us()},
                  {"shown", name_of(scene_.shown())},
                  {"settling", scene_.settling()},
                  {"coefficients", scene_.coefficients()}};
  shown_record_ << line.dump() << '\n';
}

void Session::say_state() {
  const Subscriber::Stats stats = source_.stats();
  if (said_ == stats.state) return;  // the source itself says why and when it tries again
  said_ = stats.state;
  std::string line(name_of(stats.state));
  if (!stats.detail.empty()) line += ": " + stats.detail;
  const bool fine =
      is_connected() || stats.state == Subscriber::State::kConnecting || stats.state == Subscriber::State::kWaiting;
  log(log_, fine ? LogLevel::kInfo : LogLevel::kWarning, line);
}

void Session::frame_scene(Camera& camera) {
  const SceneFacts& facts = scene_.facts();
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

void Session::draw(Renderer& renderer, const Camera& camera, RenderOptions options, int width_px, int height_px,
                   unsigned target, bool finish) {
  const TimeUs start = steady_now_us();
  renderer.upload(scene_.geometry());
  const TimeUs uploaded = steady_now_us();
  options.colourfulness = colourfulness();
  renderer.draw(camera, options, width_px, height_px, target);
  if (finish) Renderer::finish();
  const TimeUs end = steady_now_us();
  upload_us_.add(uploaded - start);
  draw_us_.add(end - uploaded);
  ++drawn_;
  if (shown_record_.is_open() && scene_.shown_capture_us()) record_shown(end);
  if (scene_.poses_shown() != drawn_pose_) {
    drawn_pose_ = scene_.poses_shown();
    if (scene_.shown_capture_us()) drawn_latency_us_.add(end - *scene_.shown_capture_us());
  }
}

bool Session::is_connected() const {
  const Subscriber::State state = source_.stats().state;
  return state == Subscriber::State::kLive || state == Subscriber::State::kDownloading;
}

float Session::colourfulness() const {
  if (!lost_since_us_ || !scene_.newest_arrival_us()) return 1;
  return std::clamp(1 - static_cast<float>(steady_now_us() - *lost_since_us_) / 500'000.0F, 0.0F, 1.0F);
}

HudFigures Session::figures() const {
  HudFigures f;
  f.keys_hz = keys_.per_second();
  f.poses_hz = poses_.per_second();
  f.drawn_hz = drawn_rate_.per_second();
  f.kbit_per_s = bytes_.per_second() * 8 / 1000;
  const Subscriber::Stats stats = source_.stats();
  f.latency_p50_us = stats.latency_us.percentile(50);
  f.latency_p99_us = stats.latency_us.percentile(99);
  f.latency_count = stats.latency_us.count();
  f.vertices = scene_.geometry().vertex_count();
  f.faces = static_cast<std::uint32_t>(scene_.geometry().triangles.size() / 3);
  f.bands = scene_.bands_received();
  if (const Asset* asset = source_.asset()) {
    f.vertices_total = asset->vertex_count;
    f.rank = asset->rank;
    f.bands_total = static_cast<std::uint32_t>(asset->band_ends.size());
  }
  const Profile profile = source_.info() ? source_.info()->profile : options_.profile.value_or(Profile{});
  f.shown = text_from_shown(scene_.shown(), scene_.settling(), scene_.playout());
  f.mode = text_from_mode(profile);
  return f;
}

std::string Session::connection() const {
  return connection_line(source_.stats(), source_.info());
}

std::string Session::banner() const {
  std::optional<TimeUs> since;
  if (scene_.newest_arrival_us()) since = steady_now_us() - *scene_.newest_arrival_us();
  return banner_text(source_.stats(), since);
}

std::string Session::report(const Renderer& renderer, int width_px, int height_px) const {
  const Subscriber::Stats stats = source_.stats();
  const HudFigures figures_now = figures();
  // Rates are those between the first and the last arrival, with the counters as they stood at both.
  const Received first = first_.value_or(Received{}), last = last_.value_or(Received{});
  const double span_s = static_cast<double>(last.arrival_us - first.arrival_us) / 1e6;
  const auto& info = source_.info();
  json report;
  report["program"] = "eigencast-client " EIGENCAST_VERSION;
  report["url"] = options_.url;
  report["stream"] = info ? info->stream : "";
  report["asset"] = info ? info->asset : "";
  report["mode"] = figures_now.mode;
  report["state"] = name_of(stats.state);
  report["duration_s"] = static_cast<double>(steady_now_us() - started_us_) / 1e6;
  report["receiving_s"] = span_s;
  report["frames_in"] = {{"keys", stats.keys},         {"synthetic", stats.synthetic},
                         {"joins", stats.joins},       {"poses", poses_taken_},
                         {"bytes", stats.bytes},       {"missed", stats.missed},
                         {"rejected", stats.rejected}, {"unusable", scene_.poses_unusable()}};
  report["frames_out"] = {{"drawn", drawn_}, {"poses_shown", scene_.poses_shown()}, {"written", written_}};
  report["rates_hz"] = {{"keys", per_second(last.keys - first.keys, span_s)},
                        {"poses", per_second(last.poses - first.poses, span_s)},
                        {"drawn", per_second(drawn_, span_s)}};
  report["kbit_per_s"] = per_second((last.bytes - first.bytes) * 8, span_s) / 1000;
  report["latency_us"] = {{"arrival", json_from(stats.latency_us)}, {"drawn", json_from(drawn_latency_us_)}};
  report["lod"] = {{"fraction", scene_.lod().fraction()},
                   {"vertices", figures_now.vertices},
                   {"of", figures_now.vertices_total},
                   {"faces", figures_now.faces}};
  report["bands"] = {{"received", figures_now.bands}, {"of", figures_now.bands_total}, {"rank", figures_now.rank}};
  const Playout& playout = scene_.playout();
  report["playout"] = {{"mode", name_of(playout.settings().mode)},
                       {"smoothness", playout.smoothness()},
                       {"delay_us", playout.delay_us()}};
  for (std::size_t i = 0; i < scene_.times_shown().size(); ++i)
    report["playout"]["shown"][std::string(name_of(static_cast<Shown>(i)))] = scene_.times_shown()[i];
  if (const Asset* asset = source_.asset())
    report["surface"] = {{"area", asset->area}, {"diagonal", asset->diagonal()}};
  report["reconnects"] = stats.reconnects;
  report["clock"] = {{"offset_us", json_from(stats.clock_offset_us)},
                     {"error_us", json_from(stats.clock_error_us)},
                     {"rtt_us", json_from(stats.rtt_us)}};
  report["asset_bytes"] = {{"downloaded", stats.asset_bytes_downloaded},
                           {"cached", stats.asset_bytes_cached},
                           {"total", stats.asset_bytes_total}};
  report["frame_time_us"] = {{"reconstruct", json_from(scene_.reconstruct_us())},
                             {"normals", json_from(scene_.normals_us())},
                             {"upload", json_from(upload_us_)},
                             {"draw", json_from(draw_us_)}};
  report["picture"] = {
      {"width", width_px}, {"height", height_px}, {"samples", renderer.samples()}, {"device", renderer.device()}};
  return report.dump(2) + "\n";
}

}  // namespace eigencast
