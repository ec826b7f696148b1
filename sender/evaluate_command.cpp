// SPDX-License-Identifier: MIT
#include <cstdio>
#include <nlohmann/json.hpp>

#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/evaluate.h"

namespace eigencast {
namespace {

nlohmann::json json_from(const SurfaceError& error) {
  return {{"kg_percent", error.kg_percent}, {"rms_over_diagonal", error.rms}, {"max_over_diagonal", error.max}};
}

nlohmann::json json_from(const Evaluation& e, const EvaluateCommand& command, const BakeResult& baked) {
  return {{"input", command.source.input},
          {"rank", baked.asset.rank},
          {"basis", baked.asset.basis_kind},
          {"codec", command.codec},
          {"rate_hz", command.rate_hz},
          {"frames", e.total.poses},
          {"truncation", json_from(e.truncation)},
          {"total", json_from(e.total)},
          {"payload_kbit_per_s", e.payload_kbit_per_s(command.rate_hz)},
          {"wire_kbit_per_s", e.wire_kbit_per_s(command.rate_hz)},
          {"join_bytes", e.join_bytes},
          {"asset_bytes", baked.encoded.total_bytes()},
          {"encode_us_p50", static_cast<double>(e.encode_ns.percentile(50)) * 1e-3},
          {"decode_us_p50", static_cast<double>(e.decode_ns.percentile(50)) * 1e-3}};
}

}  // namespace

int run(const EvaluateCommand& command, const Console& console, Interrupt& interrupt) {
  const auto codec = codec_from_name(command.codec);
  if (!codec) return report_failure(codec.error());
  const auto source = bake_with_progress(command.source, console, interrupt);
  if (!source) return report_failure(source.error());
  const Asset& asset = source->baked.asset;
  const double eps = command.error > 0 ? command.error : kDefaultErrorOverDiagonal * asset.diagonal();
  const auto result = evaluate(*source->clip, asset, *codec, eps);
  if (!result) return report_failure(result.error());
  const auto written = write_report(command.json, json_from(*result, command, source->baked).dump(2));
  if (!written) return report_failure(written.error());
  if (command.json == "-") return kExitOk;

  const auto row = [](const char* what, const SurfaceError& error) {
    std::printf("%-22s KG %.3f %%   rms %.2e   max %.2e of the diagonal\n", what, error.kg_percent, error.rms,
                error.max);
  };
  std::printf("%s, %zu frames, %s basis, r = %u, %s\n", command.source.input.c_str(), result->total.poses,
              asset.basis_kind.c_str(), asset.rank, command.codec.c_str());
  row("basis alone", result->truncation);
  row("basis and codec", result->total);
  std::printf("quantising adds %.2e of the diagonal (area-weighted rms; asked for %.2e)\n",
              result->quantising_rms / asset.diagonal(), eps / asset.diagonal());
  std::printf("%.1f kbit/s payload, %.1f kbit/s with envelope and WebSocket header, at %g poses/s\n",
              result->payload_kbit_per_s(command.rate_hz), result->wire_kbit_per_s(command.rate_hz), command.rate_hz);
  std::printf("asset %.2f MB; join frame %llu bytes; encode %.1f us, decode %.1f us (median)\n",
              static_cast<double>(source->baked.encoded.total_bytes()) * 1e-6,
              static_cast<unsigned long long>(result->join_bytes),
              static_cast<double>(result->encode_ns.percentile(50)) * 1e-3,
              static_cast<double>(result->decode_ns.percentile(50)) * 1e-3);
  return kExitOk;
}

}  // namespace eigencast
