// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>

#include "common/core/text.h"
#include "sdk/pose_projection.h"
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

double us_p50(const Histogram& ns) {
  return static_cast<double>(ns.percentile(50)) * 1e-3;
}

json json_from(const CodedKeys& keys, double diagonal, double rate_hz) {
  return {{"frames", keys.frames},
          {"frames_from_memory", keys.recalled},
          {"quantising_rms_over_diagonal", keys.quantising_rms / diagonal},
          {"payload_kbit_per_s", keys.payload_kbit_per_s(rate_hz)},
          {"wire_kbit_per_s", keys.wire_kbit_per_s(rate_hz)},
          {"encode_us_p50", us_p50(keys.encode_ns)},
          {"decode_us_p50", us_p50(keys.decode_ns)}};
}

json json_from(const AgainEvaluation& again, const CodedKeys& first, double diagonal, double rate_hz) {
  const auto payback_s = again.payback_s(rate_hz);
  return {{"passes", again.options.passes},
          {"warp", again.options.warp},
          {"noise_over_diagonal", again.options.noise},
          {"without_memory", json_from(again.plain, diagonal, rate_hz)},
          {"with_memory", json_from(again.recalled, diagonal, rate_hz)},
          {"with_memory_at_equal_error", json_from(again.equal, diagonal, rate_hz)},
          {"equal_error_over_diagonal", again.equal_eps / diagonal},
          {"memory_poses", again.poses},
          {"memory_bytes", again.memory_bytes},
          {"first_use_s", static_cast<double>(again.first_use) / rate_hz},
          {"payback_s", payback_s ? json(*payback_s) : json()},
          {"in_all_kbit_per_s", again.in_all_kbit_per_s(first, rate_hz)}};
}

json json_from(const LoopEvaluation& loop, double diagonal) {
  const double rate_hz = loop.options.rate_hz;
  const auto or_null = [](const std::optional<double>& value) { return value ? json(*value) : json(); };
  return {{"seconds", loop.options.seconds},
          {"without_memory", json_from(loop.plain, diagonal, rate_hz)},
          {"with_memory", json_from(loop.live, diagonal, rate_hz)},
          {"error", json_from(loop.error)},
          {"memory_poses", loop.poses},
          {"memory_roots", loop.roots},
          {"memory_bytes", loop.memory_bytes},
          {"first_use_s", or_null(loop.first_use_s)},
          {"paid_back_s", or_null(loop.paid_back_s)},
          {"in_all_kbit_per_s", loop.in_all_kbit_per_s()},
          {"keep_us_mean", loop.keep_ns.mean() * 1e-3},
          {"keep_us_max", static_cast<double>(loop.keep_ns.max()) * 1e-3},
          {"kbit_per_s_by_second", loop.kbit_per_s},
          {"kbit_per_s_by_second_without_memory", loop.plain_kbit_per_s}};
}

json json_from(const LearnEvaluation& learn, double diagonal, double rate_hz) {
  const auto judged = [&](const JudgedKeys& seen) {
    json value = json_from(seen.keys, diagonal, rate_hz);
    value["error"] = json_from(seen.error);
    value["eps_over_diagonal"] = seen.eps / diagonal;
    return value;
  };
  json value = {{"seconds", learn.options.seconds},
                {"poses", learn.poses},
                {"columns", learn.columns},
                {"side_bytes", learn.bytes},
                {"pays", learn.pays},
                {"learn_ms", learn.learn_ms},
                {"add_us_mean", learn.add_ns.mean() * 1e-3}};
  if (learn.trial) {
    const auto payback_s = learn.trial->payback_s(learn.bytes);
    value["trial"] = {{"basis_rms_over_diagonal", learn.trial->basis_error / diagonal},
                      {"basis_rms_over_diagonal_with_columns", learn.trial->learnt_error / diagonal},
                      {"quantising_rms_over_diagonal", learn.trial->coding_error / diagonal},
                      {"wire_kbit_per_s", learn.trial->kbit_per_s},
                      {"wire_kbit_per_s_with_columns_at_equal_error", learn.trial->equal_kbit_per_s},
                      {"payback_s", payback_s ? json(*payback_s) : json()}};
  }
  if (learn.rest) {
    value["rest"] = {{"without_columns", judged(learn.rest->plain)},
                     {"with_columns", judged(learn.rest->learnt)},
                     {"with_columns_at_equal_bits", judged(learn.rest->other)}};
  }
  if (learn.again) {
    value["again"] = {{"without_columns_and_memory", judged(learn.again->other)},
                      {"with_memory", judged(learn.again->plain)},
                      {"with_columns_and_memory", judged(learn.again->learnt)}};
  }
  return value;
}

json json_from(const EvaluatedRow& row, double rate_hz) {
  const Evaluation& e = row.evaluation;
  json levels = json::array();
  for (const LevelError& level : e.levels) levels.push_back(json_from(level));
  json value = {{"basis", row.basis},
                {"detail", row.detail},
                {"rank", row.rank},
                {"error_over_diagonal", row.eps / row.diagonal},
                {"frames", e.total.poses},
                {"truncation", json_from(e.truncation)},
                {"total", json_from(e.total)},
                {"levels", levels},
                {"rms_over_diagonal_by_frame", e.rms_by_frame},
                {"quantising_rms_over_diagonal", e.keys.quantising_rms / row.diagonal},
                {"still_settles_after_poses", e.still.settles_after},
                {"still_moves_over_diagonal", e.still.moves},
                {"payload_kbit_per_s", e.keys.payload_kbit_per_s(rate_hz)},
                {"wire_kbit_per_s", e.keys.wire_kbit_per_s(rate_hz)},
                {"join_bytes", e.join_bytes},
                {"asset_bytes", row.asset_bytes},
                {"encode_us_p50", us_p50(e.keys.encode_ns)},
                {"decode_us_p50", us_p50(e.keys.decode_ns)}};
  if (e.again) value["again"] = json_from(*e.again, e.keys, row.diagonal, rate_hz);
  if (row.trial) value["trial"] = json_from(*row.trial);
  if (e.learn) value["learn"] = json_from(*e.learn, row.diagonal, rate_hz);
  if (e.loop) value["loop"] = json_from(*e.loop, row.diagonal);
  return value;
}

std::string table_line(const EvaluatedRow& row, const LevelError& level, double rate_hz) {
  const Evaluation& e = row.evaluation;
  return formatted("%-16s %5u %8.2e %5g %8u %7.3f %8.2e %8.2e %8.2e %9.2e %8.2e %8.1f %6.2f\n", row.basis.c_str(),
                   row.rank, row.eps / row.diagonal, level.fraction, level.vertices, level.vertex.kg_percent,
                   level.vertex.rms, level.vertex.mean, level.vertex.max, level.hausdorff, level.edges.combined(),
                   e.keys.wire_kbit_per_s(rate_hz), static_cast<double>(row.asset_bytes) * 1e-6);
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
      e.truncation.rms, e.keys.quantising_rms / row.diagonal, still.c_str(),
      static_cast<unsigned long long>(e.join_bytes), us_p50(e.keys.encode_ns), us_p50(e.keys.decode_ns));
}

std::string notes_on_again(const EvaluatedRow& row, double rate_hz) {
  const AgainEvaluation& a = *row.evaluation.again;
  const auto pass = [&](const CodedKeys& keys) {
    return formatted("%.1f kbit/s (%.2e)", keys.wire_kbit_per_s(rate_hz), keys.quantising_rms / row.diagonal);
  };
  const auto payback_s = a.payback_s(rate_hz);
  return formatted(
      "again at %g of the speed, %.1e noise: %s; with a memory of %u poses %s, at equal error %s; %llu of %llu frames "
      "come from it, the first after %.1f s; its %.1f kB pay back %s; all %u passes and the memory %.1f kbit/s; encode "
      "%.1f us, decode %.1f us (median)\n",
      a.options.warp, a.options.noise, pass(a.plain).c_str(), a.poses, pass(a.recalled).c_str(), pass(a.equal).c_str(),
      static_cast<unsigned long long>(a.recalled.recalled), static_cast<unsigned long long>(a.recalled.frames),
      static_cast<double>(a.first_use) / rate_hz, static_cast<double>(a.memory_bytes) * 1e-3,
      payback_s ? formatted("in %.1f s", *payback_s).c_str() : "never", a.options.passes,
      a.in_all_kbit_per_s(row.evaluation.keys, rate_hz), us_p50(a.recalled.encode_ns), us_p50(a.recalled.decode_ns));
}

/// No other way has fewer bits and less error.
std::string curve_of(const RankTrial& trial) {
  std::string text = text_of(trial) + "\n  kbit/s     error     r products   coding\n";
  const TrialPoint& c = trial.chosen;
  std::vector<TrialPoint> points = trial.points;  // Of what is chosen as the asset has it alone.
  std::erase_if(points, [&](const TrialPoint& p) {
    return p.rank == c.rank && p.products == c.products && p.coding == c.coding && p != c;
  });
  points = front_of(std::move(points));
  if (std::find(points.begin(), points.end(), c) == points.end()) points.push_back(c);
  for (const TrialPoint& p : points) {
    text += formatted("%s %6.1f  %8.2e  %4d %8d %8.2e\n", p == c ? ">" : " ", p.kbit_per_s, p.error, p.rank, p.products,
                      p.coding);
  }
  return text;
}

std::string notes_on(const LoopEvaluation& loop) {
  const auto seconds = [](const std::optional<double>& at) { return at ? formatted("%.1f s", *at) : "never"; };
  return formatted(
      "in a loop for %g s: %.1f kbit/s, all counted, without memory %.1f; KG %.3f %%; %.1f kB of memory in %u poses, "
      "%u "
      "new roots; used after %s, paid back after %s; encode %.1f us (median), keep %.1f us (mean, at most %.0f)\n",
      loop.options.seconds, loop.in_all_kbit_per_s(), loop.plain.wire_kbit_per_s(loop.options.rate_hz),
      loop.error.kg_percent, static_cast<double>(loop.memory_bytes) * 1e-3, loop.poses, loop.roots,
      seconds(loop.first_use_s).c_str(), seconds(loop.paid_back_s).c_str(), us_p50(loop.live.encode_ns),
      loop.keep_ns.mean() * 1e-3, static_cast<double>(loop.keep_ns.max()) * 1e-3);
}

std::string notes_on(const LearnEvaluation& learn, double rate_hz) {
  const auto seen = [&](const JudgedKeys& judged) {
    return formatted("%.1f kbit/s, KG %.3f %%", judged.keys.wire_kbit_per_s(rate_hz), judged.error.kg_percent);
  };
  const auto payback_s = learn.trial ? learn.trial->payback_s(learn.bytes) : std::nullopt;
  std::string text = formatted(
      "%u columns learnt from %zu poses in %.0f ms, %.0f us a pose: %.1f kB, which pay back %s: live, it %s\n",
      learn.columns, learn.poses, learn.learn_ms, learn.add_ns.mean() * 1e-3, static_cast<double>(learn.bytes) * 1e-3,
      payback_s ? formatted("in %.0f s", *payback_s).c_str() : "never", learn.pays ? "learns" : "does not");
  if (learn.rest) {
    text += "  the other poses: " + seen(learn.rest->plain) + "; with columns " + seen(learn.rest->learnt) +
            "; at as many bits " + seen(learn.rest->other) + "\n";
  }
  if (learn.again) {
    text += "  again: " + seen(learn.again->other) + "; with a memory " + seen(learn.again->plain) +
            "; with columns, too, " + seen(learn.again->learnt) + "\n";
  }
  return text;
}

/// Vertex errors that quantising may add, model units.
std::vector<double> errors_of(const EvaluateCommand& command, const Asset& asset) {
  std::vector<double> errors = command.errors;
  for (const double step : command.steps) errors.push_back(eps_from_step(asset, step));
  if (errors.empty()) errors.push_back(error_bound({}, asset));
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
  if (command.sweep && options.target_error == 0 && options.quality == 0 && options.bitrate_kbit == 0)
    options.quality = 1;
  // Among several bases those that hold the rest pose have nothing to bring back.
  if (command.bases.size() > 1 && !leaves_detail(basis)) options.detail.clear();
  const auto source = bake_with_progress(options, console, interrupt);
  if (!source) return source.error();
  const Asset& asset = source->baked.asset;
  for (const double eps : errors_of(command, asset)) {
    ProgressLine line(console.progress, stops_at(interrupt));
    EvaluateOptions how{codec, eps, command.levels, options.any_order};
    if (command.again) how.again = command.again_options;
    if (command.loop_s > 0) how.loop = {command.loop_s, command.rate_hz};
    if (command.learn_s > 0) how.learn = {command.learn_s, command.rate_hz, &source->baked.encoded};
    auto evaluation = evaluate(*source->clip, asset, how, std::ref(line));
    line.finish();
    if (!evaluation) return evaluation.error();
    if (rows.empty()) {  // The same frames in all of them.
      for (const std::string& finding : evaluation->findings) spdlog::warn("{}", finding);
    }
    evaluation->findings.insert(evaluation->findings.begin(), source->findings.begin(), source->findings.end());
    rows.push_back({asset.basis_kind, std::string(name_of(detail_of(asset))), asset.rank, asset.diagonal(),
                    source->baked.encoded.total_bytes(), eps, source->baked.trial, std::move(*evaluation)});
  }
  return {};
}

json json_from(const TrialPoint& point) {
  return {{"rank", point.rank},
          {"products", point.products},
          {"error_over_diagonal", point.coding},
          {"rms_over_diagonal", point.error},
          {"wire_kbit_per_s", point.kbit_per_s}};
}

}  // namespace

json json_from(const RankTrial& trial) {
  json points = json::array(), front = json::array();
  for (const TrialPoint& point : trial.points) points.push_back(json_from(point));
  for (const TrialPoint& point : front_of(trial.points)) front.push_back(json_from(point));
  return {{"chosen", json_from(trial.chosen)},
          {"asked", trial.asked},
          {"is_rate", trial.is_rate},
          {"is_met", trial.is_met()},
          {"made_poses", trial.is_made},
          {"why", text_of(trial)},
          {"front", front},
          {"points", points}};
}

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
  for (const EvaluatedRow& row : clip.rows) {
    text += notes_on(row);
    if (row.evaluation.again) text += notes_on_again(row, clip.rate_hz);
    if (clip.sweep && row.trial) text += curve_of(*row.trial);
    if (row.evaluation.loop) text += notes_on(*row.evaluation.loop);
    if (row.evaluation.learn) text += notes_on(*row.evaluation.learn, clip.rate_hz);
  }
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
  EvaluatedClip clip{command.source.input, command.codec, command.rate_hz, command.sweep, {}};
  for (const BasisKind basis : command.bases) {
    for (const int rank : command.ranks) {
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
