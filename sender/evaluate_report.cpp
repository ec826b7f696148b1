// SPDX-License-Identifier: MIT
#include "sender/evaluate_report.h"

#include <nlohmann/json.hpp>

#include "common/core/text.h"

namespace eigencast {
namespace {

using nlohmann::json;

json json_from(const LevelError& level) {
  json value = json_from(level.vertex);
  value.update({{"lod", level.fraction},
                {"vertices", level.vertices},
                {"hausdorff_over_diagonal", level.hausdorff},
                {"sted", level.edges.combined()},
                {"sted_spatial", level.edges.spatial},
                {"sted_temporal", level.edges.temporal}});
  return value;
}

json json_from(const EvaluatedRow& row, double rate_hz) {
  const Evaluation& e = row.evaluation;
  json levels = json::array();
  for (const LevelError& level : e.levels) levels.push_back(json_from(level));
  return {{"basis", row.basis},
          {"detail", row.detail},
          {"rank", row.rank},
          {"error_over_diagonal", row.eps / row.diagonal},
          {"frames", e.total.poses},
          {"truncation", json_from(e.truncation)},
          {"total", json_from(e.total)},
          {"levels", levels},
          {"rms_over_diagonal_by_frame", e.rms_by_frame},
          {"quantising_rms_over_diagonal", e.quantising_rms / row.diagonal},
          {"still_settles_after_poses", e.still.settles_after},
          {"still_moves_over_diagonal", e.still.moves},
          {"payload_kbit_per_s", e.payload_kbit_per_s(rate_hz)},
          {"wire_kbit_per_s", e.wire_kbit_per_s(rate_hz)},
          {"join_bytes", e.join_bytes},
          {"asset_bytes", row.asset_bytes},
          {"encode_us_p50", static_cast<double>(e.encode_ns.percentile(50)) * 1e-3},
          {"decode_us_p50", static_cast<double>(e.decode_ns.percentile(50)) * 1e-3}};
}

std::string table_line(const EvaluatedRow& row, const LevelError& level, double rate_hz) {
  const Evaluation& e = row.evaluation;
  return formatted("%-16s %5u %8.2e %5g %8u %7.3f %8.2e %8.2e %8.2e %9.2e %8.2e %8.1f %6.2f\n", row.basis.c_str(),
                   row.rank, row.eps / row.diagonal, level.fraction, level.vertices, level.vertex.kg_percent,
                   level.vertex.rms, level.vertex.mean, level.vertex.max, level.hausdorff, level.edges.combined(),
                   e.wire_kbit_per_s(rate_hz), static_cast<double>(row.asset_bytes) * 1e-6);
}

std::string notes_on(const EvaluatedRow& row) {
  const Evaluation& e = row.evaluation;
  std::string still = e.still.settles_after == 0
                          ? "a still pose changes nothing from the first pose on"
                          : formatted("a still pose changes up to its pose %zu", e.still.settles_after);
  if (e.still.moves > 0) still += formatted(" and goes on to move by %.1e of the diagonal (rms)", e.still.moves);
  return formatted(
      "%s, r = %u, detail %s, error %.2e: basis alone KG %.3f %%, rms %.2e; quantising adds %.2e (area-weighted rms); "
      "%s; join "
      "frame "
      "%llu bytes; encode %.1f us, decode %.1f us (median)\n",
      row.basis.c_str(), row.rank, row.detail.c_str(), row.eps / row.diagonal, e.truncation.kg_percent,
      e.truncation.rms, e.quantising_rms / row.diagonal, still.c_str(), static_cast<unsigned long long>(e.join_bytes),
      static_cast<double>(e.encode_ns.percentile(50)) * 1e-3, static_cast<double>(e.decode_ns.percentile(50)) * 1e-3);
}

}  // namespace

std::string table_of(const EvaluatedClip& clip) {
  const std::size_t frames = clip.rows.empty() ? 0 : clip.rows.front().evaluation.total.poses;
  std::string text = formatted(
      "%s, %zu frames, %s, %g poses/s; errors over the rest box's diagonal; kbit/s with envelope and "
      "WebSocket "
      "header\n",
      clip.input.c_str(), frames, clip.codec.c_str(), clip.rate_hz);
  text +=
      "basis                r    error   lod vertices    KG %      rms     mean      max Hausdorff     STED   kbit/s   "
      "  "
      "MB\n";
  for (const EvaluatedRow& row : clip.rows) {
    for (const LevelError& level : row.evaluation.levels) text += table_line(row, level, clip.rate_hz);
  }
  for (const EvaluatedRow& row : clip.rows) text += notes_on(row);
  return text;
}

std::string report_of(const EvaluatedClip& clip) {
  json results = json::array();
  for (const EvaluatedRow& row : clip.rows) results.push_back(json_from(row, clip.rate_hz));
  const json findings = clip.rows.empty() ? json::array() : json(clip.rows.front().evaluation.findings);
  return json{{"input", clip.input},
              {"findings", findings},
              {"codec", clip.codec},
              {"rate_hz", clip.rate_hz},
              {"results", results}}
      .dump(2);
}

}  // namespace eigencast
