// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>

#include "common/core/text.h"
#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/console.h"
#include "sender/evaluate.h"

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
      "%s; join frame %llu bytes; encode %.1f us, decode %.1f us (median)\n",
      row.basis.c_str(), row.rank, row.detail.c_str(), row.eps / row.diagonal, e.truncation.kg_percent,
      e.truncation.rms, e.quantising_rms / row.diagonal, still.c_str(), static_cast<unsigned long long>(e.join_bytes),
      static_cast<double>(e.encode_ns.percentile(50)) * 1e-3, static_cast<double>(e.decode_ns.percentile(50)) * 1e-3);
}

/// Vertex errors that quantising may add, model units.
std::vector<double> errors_of(const EvaluateCommand& command, const Asset& asset) {
  std::vector<double> errors = command.errors;
  for (const double step : command.steps) errors.push_back(eps_from_step(asset, step));
  if (errors.empty()) errors.push_back(kDefaultErrorOverDiagonal * asset.diagonal());
  return errors;
}

Result<void> check_bases(const EvaluateCommand& command) {
  if (command.bases.size() < 2) return {};
  const auto clip = open_source(command.source);
  if (!clip) return clip.error();
  for (const BasisKind basis : command.bases) {
    if (const auto usable = check_basis(basis, **clip); !usable)
      return in_context(command.source.input, usable.error());
  }
  return {};
}

Result<void> evaluate_basis(const EvaluateCommand& command, BasisKind basis, int rank, CodecKind codec,
                            const Console& console, Interrupt& interrupt, std::vector<EvaluatedRow>& rows) {
  SourceOptions options = command.source;
  options.basis = basis;
  options.rank = rank;
  // Among several bases those that hold the rest pose have nothing to bring back.
  if (command.bases.size() > 1 && !leaves_detail(basis)) options.detail.clear();
  const auto source = bake_with_progress(options, console, interrupt);
  if (!source) return source.error();
  const Asset& asset = source->baked.asset;
  for (const double eps : errors_of(command, asset)) {
    ProgressLine line(console.progress, interrupt);
    auto evaluation = evaluate(*source->clip, asset, {codec, eps, command.levels, options.any_order}, std::ref(line));
    line.finish();
    if (!evaluation) return evaluation.error();
    if (rows.empty()) {  // The same frames in all of them.
      for (const std::string& finding : evaluation->findings) spdlog::warn("{}", finding);
    }
    evaluation->findings.insert(evaluation->findings.begin(), source->findings.begin(), source->findings.end());
    rows.push_back({asset.basis_kind, std::string(name_of(detail_of(asset))), asset.rank, asset.diagonal(),
                    source->baked.encoded.total_bytes(), eps, std::move(*evaluation)});
  }
  return {};
}

}  // namespace

std::string table_of(const EvaluatedClip& clip) {
  const std::size_t frames = clip.rows.empty() ? 0 : clip.rows.front().evaluation.total.poses;
  std::string text = formatted(
      "%s, %zu frames, %s, %g poses/s; errors over the rest box's diagonal; kbit/s with envelope and WebSocket "
      "header\n",
      clip.input.c_str(), frames, clip.codec.c_str(), clip.rate_hz);
  text +=
      "basis                r    error   lod vertices    KG %      rms     mean      max Hausdorff     STED   kbit/s   "
      "  MB\n";
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

int run(const EvaluateCommand& command, const Console& console, Interrupt& interrupt) {
  const auto codec = codec_from_name(command.codec);
  if (!codec) return report_failure(codec.error());
  if (const auto usable = check_bases(command); !usable) return report_failure(usable.error());
  EvaluatedClip clip{command.source.input, command.codec, command.rate_hz, {}};
  for (const BasisKind basis : command.bases) {
    for (const int rank : command.source.target_error > 0 ? std::vector{0} : command.ranks) {
      const auto done = evaluate_basis(command, basis, rank, *codec, console, interrupt, clip.rows);
      if (!done) return report_failure(done.error());
    }
  }
  const auto written = write_report(command.json, report_of(clip));
  if (!written) return report_failure(written.error());
  if (command.json != "-") std::fputs(table_of(clip).c_str(), stdout);
  return kExitOk;
}

}  // namespace eigencast
