// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <cstdio>
#include <functional>

#include "common/core/text.h"
#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/evaluate.h"
#include "sender/evaluate_report.h"
#include "sender/progress_line.h"

namespace eigencast {
namespace {

struct CodecToTry {
  double eps = 0;  ///< Vertex error that quantising may add, model units.
  std::string name;
};

std::vector<CodecToTry> codecs_of(const EvaluateCommand& command, const Asset& asset) {
  std::vector<CodecToTry> codecs;
  for (const double eps : command.errors) codecs.push_back({eps, formatted("error %g", eps)});
  for (const double step : command.steps) codecs.push_back({eps_from_step(asset, step), formatted("step %g", step)});
  if (codecs.empty()) codecs.push_back({kDefaultErrorOverDiagonal * asset.diagonal(), "default error"});
  return codecs;
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
  // Of several bases those that hold the rest pose have nothing to bring back.
  if (command.bases.size() > 1 && !leaves_detail(basis)) options.detail.clear();
  const auto source = bake_with_progress(options, console, interrupt);
  if (!source) return source.error();
  const Asset& asset = source->baked.asset;
  for (const auto& [eps, name] : codecs_of(command, asset)) {
    ProgressLine line(console.progress, interrupt);
    auto evaluation = evaluate(*source->clip, asset, {codec, eps, command.levels, options.any_order}, std::ref(line));
    line.finish();
    if (!evaluation) return evaluation.error();
    if (rows.empty()) {  // The same frames in all of them.
      for (const std::string& finding : evaluation->findings) spdlog::warn("{}", finding);
    }
    evaluation->findings.insert(evaluation->findings.begin(), source->findings.begin(), source->findings.end());
    rows.push_back({asset.basis_kind, std::string(name_of(detail_of(asset))), asset.rank, asset.diagonal(),
                    source->baked.encoded.total_bytes(), eps, name, std::move(*evaluation)});
  }
  return {};
}

}  // namespace

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
