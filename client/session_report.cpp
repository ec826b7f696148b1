// SPDX-License-Identifier: MIT
#include <array>
#include <nlohmann/json.hpp>
#include <string_view>

#include "client/session.h"
#include "common/asset/detail.h"
#include "common/wire/link_bytes.h"

namespace eigencast {
namespace {

using nlohmann::json;

json json_from(const Histogram& h) {
  return {{"count", h.count()},      {"p50", h.percentile(50)}, {"p90", h.percentile(90)},
          {"p99", h.percentile(99)}, {"max", h.max()},          {"negative", h.negative()}};
}

json parts_from(const Histogram& permille) {
  return {{"mean", permille.mean() / 1000},
          {"p5", static_cast<double>(permille.percentile(5)) / 1000},
          {"p50", static_cast<double>(permille.percentile(50)) / 1000}};
}

json json_from(const std::optional<TimeUs>& value) {
  return value ? json(*value) : json(nullptr);
}

double per_second(std::uint64_t count, double seconds) {
  return seconds > 0 ? static_cast<double>(count) / seconds : 0;
}

json surfaces_from(const Scene& scene, std::span<PoseSource* const> sources) {
  json surfaces = json::array();
  for (const Scene::Instance& instance : scene.instances()) {
    const PoseSource& source = *sources[instance.placement.source];
    const Asset* asset = source.asset();
    const SurfaceView& view = instance.view;
    surfaces.push_back({{"stream", instance.placement.source},
                        {"name", instance.placement.name},
                        {"state", kStateNames[source.stats().state]},
                        {"poses_shown", view.poses_shown()},
                        {"vertices", view.geometry().vertex_count()},
                        {"of", asset == nullptr ? 0 : asset->vertex_count},
                        {"faces", view.geometry().triangles.size() / 3},
                        {"rebuilt", view.geometry().gpu ? "gpu" : "cpu"},
                        {"detail", asset == nullptr ? "none" : name_of(detail_of(*asset))}});
  }
  return surfaces;
}

json json_from(RoomDesk& room, const Scene& scene, std::span<PoseSource* const> sources) {
  json people = json::array(), marks = json::array();
  for (const auto& [id, member] : room.state().members)
    people.push_back({{"id", id}, {"name", member.name}, {"here", member.here}});
  for (const RoomDesk::Mark& mark : room.marks(scene, sources))
    marks.push_back({{"text", mark.text}, {"pin", mark.is_pin}, {"at", {mark.at.x, mark.at.y, mark.at.z}}});
  return {{"self", room.state().self},
          {"speaks", room.state().speaks},
          {"trouble", room.state().trouble},
          {"members", people},
          {"marks", marks}};
}

std::string_view name_of(FrameKind kind) {
  constexpr std::array<std::string_view, 5> kNames{"unknown", "key", "join", "step", "estimate"};
  const auto number = static_cast<std::size_t>(kind);
  return kNames[number < kNames.size() ? number : 0];
}

Result<void> open_file(const std::string& path, std::ofstream& file) {
  if (path.empty()) return {};
  file.open(path, std::ios::trunc);
  return file ? Result<void>() : fail(ErrorCode::kIo, path + ": cannot be written; is its folder there?");
}

}  // namespace

Result<void> PoseRecord::open(const std::string& received, const std::string& shown) {
  if (Result<void> opened = open_file(received, received_); !opened) return opened;
  return open_file(shown, shown_);
}

void PoseRecord::received(std::size_t source, std::span<const ReceivedPose> poses) {
  if (!received_.is_open() || poses.empty()) return;
  for (const ReceivedPose& pose : poses) {
    const Envelope& e = pose.envelope;
    const json line{{"stream", source},
                    {"kind", name_of(e.kind)},
                    {"sequence", e.sequence},
                    {"at", e.step.at},
                    {"of", e.step.of},
                    {"epoch", e.epoch},
                    {"bands", e.bands.bits},
                    {"capture_us", e.capture_us},
                    {"arrival_us", pose.arrival_us},
                    {"channels", pose.channels},
                    {"coefficients", std::span(pose.coefficients)}};
    received_ << line.dump() << '\n';
  }
  received_.flush();
}

void PoseRecord::shown(const Scene& scene, std::span<PoseSource* const> sources, TimeUs drawn_us) {
  if (!shown_.is_open()) return;
  for (std::size_t i = 0; i < scene.instances().size(); ++i) {
    const SurfaceView& view = scene.instances()[i].view;
    if (!view.shown_capture_us()) continue;
    const json line{{"surface", i},
                    {"drawn_us", drawn_us},
                    {"capture_us", *view.shown_capture_us()},
                    {"utc_us", json_from(utc_shown(view, *sources[scene.instances()[i].placement.source]))},
                    {"shown", kShownNames[view.shown()]},
                    {"settling", view.settling()},
                    {"vertices", view.geometry().vertex_count()},
                    {"coefficients", view.coefficients()}};
    shown_ << line.dump() << '\n';
  }
  shown_.flush();
}

std::string Session::report(const Renderer& renderer, int width_px, int height_px) const {
  const Subscriber::Stats& stats = connections_.stats();
  const HudFigures figures_now = figures();
  if (scene_.instances().empty())
    return json{{"program", "eigencast-client " EIGENCAST_VERSION}, {"surfaces", json::array()}}.dump(2) + "\n";
  const PoseSource& source = *sources()[scene_.instances().front().placement.source];
  const SurfaceView& view = scene_.instances().front().view;
  std::uint64_t unusable = 0;
  for (const Scene::Instance& instance : scene_.instances()) unusable += instance.view.poses_unusable();
  // Rates are those between the first and the last arrival, with the counters' values at both.
  const Received first = first_.value_or(Received{}), last = last_.value_or(Received{});
  const double span_s = static_cast<double>(last.arrival_us - first.arrival_us) / 1e6;
  const auto& info = source.info();
  json report;
  report["program"] = "eigencast-client " EIGENCAST_VERSION;
  report["url"] = options_.scene.streams.empty() ? "" : options_.scene.streams.front();
  report["stream"] = info ? info->stream : "";
  report["asset"] = info ? info->asset : "";
  report["mode"] = figures_now.mode;
  report["state"] = kStateNames[stats.state];
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
  const LinkBytes more =
      link_bytes(static_cast<double>(last.frames - first.frames), static_cast<double>(last.bytes - first.bytes));
  const auto kbit_per_s = [&](double bytes) { return span_s > 0 ? bytes * 8e-3 / span_s : 0.0; };
  report["link_kbit_per_s"] = {
      {"websocket", kbit_per_s(more.websocket)}, {"tcp_ip", kbit_per_s(more.tcp_ip)}, {"tls", kbit_per_s(more.tls)}};
  report["memory"] = {{"keys_recalled", stats.recalled}, {"bytes", stats.memory_bytes}};
  report["latency_us"] = {{"arrival", json_from(stats.latency_us)}, {"drawn", json_from(drawn_latency_us_)}};
  report["lod"] = {{"fraction", scene_.lod().fraction()},
                   {"vertices", figures_now.vertices},
                   {"of", figures_now.vertices_total},
                   {"faces", figures_now.faces},
                   {"resolver", kResolverNames[levels_.kind()]},
                   {"target_fps", levels_.active() ? json(levels_.target_fps()) : json(nullptr)},
                   {"state", levels_.active() ? json(levels_.state()) : json(nullptr)}};
  const PictureQuality& quality = levels_.quality();
  report["quality"] = {{"mode", kQualityNames[levels_.settings().quality]},
                       {"scale", quality.scale},
                       {"samples", quality.samples},
                       {"shadow", kShadowNames[quality.shadow]},
                       {"ground", quality.ground}};
  report["lowered"] = {{"pictures", used_permille_.count()},
                       {"used", parts_from(used_permille_)},
                       {"vertices", parts_from(drawn_permille_)}};
  report["surfaces"] = surfaces_from(scene_, sources());
  report["reconstruct"] = {
      {"asked", kRebuildOnNames[options_.reconstruct]},
      {"trial_us",
       rebuild_trial_ ? json{{"cpu", rebuild_trial_->cpu_us}, {"gpu", rebuild_trial_->gpu_us}} : json(nullptr)}};
  report["bands"] = {{"received", figures_now.bands}, {"of", figures_now.bands_total}, {"rank", figures_now.rank}};
  const Playout& playout = view.playout();
  report["playout"] = {{"mode", kPlayoutNames[playout.settings().mode]},
                       {"smoothness", playout.smoothness()},
                       {"delay_us", playout.delay_us()}};
  report["playout"]["lag_us"] = json_from(playout.lag_us());
  const auto utc_us = shown_utc_us();
  report["shown"] = {{"capture_us", json_from(view.shown_capture_us())},
                     {"utc_us", json_from(utc_us)},
                     {"timecode", utc_us ? json(timecode_of(*utc_us)) : json(nullptr)}};
  if (seek_us_.count() > 0) report["seek_us"] = json_from(seek_us_);
  if (rewind_.past_us()) {
    report["shown"]["at_us"] = *rewind_.past_us();
    report["shown"]["behind_us"] = rewind_.bar()->now_us - *rewind_.past_us();
  }
  for (std::size_t i = 0; i < view.times_shown().size(); ++i)
    report["playout"]["shown"][std::string(kShownNames[static_cast<Shown>(i)])] = view.times_shown()[i];
  if (const Asset* asset = source.asset()) report["surface"] = {{"area", asset->area}, {"diagonal", asset->diagonal()}};
  if (room_) report["room"] = json_from(*room_, scene_, sources());
  if (figures_now.difference)
    report["difference"] = {{"rms", figures_now.difference->rms}, {"largest", figures_now.difference->largest}};
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
  return report.dump(2, ' ', false, json::error_handler_t::replace) + "\n";  // Names may come from a hostile file.
}

}  // namespace eigencast
