// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "sdk/asset_folder.h"
#include "sender/commands.h"
#include "sender/evaluate.h"

namespace eigencast {
namespace {

nlohmann::json json_from(const std::vector<GeometricError>& errors) {
  nlohmann::json levels = nlohmann::json::array();
  for (const auto& [rows, rms, largest] : errors)
    levels.push_back({{"vertices", rows}, {"rms_over_diagonal", rms}, {"largest_over_diagonal", largest}});
  return levels;
}

std::string json_from(const Source& source) {
  const BakeResult& baked = source.baked;
  nlohmann::json report = {{"asset", baked.encoded.manifest.id.hex()},
                           {"name", baked.asset.name},
                           {"vertices", baked.asset.vertex_count},
                           {"faces", baked.asset.face_total},
                           {"rank", baked.asset.rank},
                           {"basis", baked.asset.basis_kind},
                           {"operator", baked.asset.operator_kind},
                           {"level_errors", json_from(baked.asset.level_errors)},
                           {"bytes", baked.encoded.total_bytes()},
                           {"chunks", baked.encoded.chunks.size()},
                           {"certified", baked.certified},
                           {"approximate", baked.approximate},
                           {"residual", baked.residual},
                           {"from_cache", baked.from_cache},
                           {"findings", source.findings}};
  if (baked.trial) report["trial"] = json_from(*baked.trial);
  return report.dump(2);
}

void print(const BakeResult& baked) {
  std::fputs(baked.report.c_str(), stdout);
  std::printf("asset %s\n%u vertices, %u faces, r = %u (%s), %.2f MB in %zu chunks%s\n",
              baked.encoded.manifest.id.hex().c_str(), baked.asset.vertex_count, baked.asset.face_total,
              baked.asset.rank, baked.asset.basis_kind.c_str(), static_cast<double>(baked.encoded.total_bytes()) * 1e-6,
              baked.encoded.chunks.size(), baked.from_cache ? ", from the cache" : "");
}

}  // namespace

int run(const BakeCommand& command, const Console& console, Interrupt& interrupt) {
  const auto source = bake_with_progress(command.source, console, interrupt);
  if (!source) return report_failure(source.error());
  const BakeResult& baked = source->baked;
  if (command.json != "-") print(baked);
  if (!command.out_dir.empty()) {
    if (const auto written = write_asset(baked.encoded, baked.asset.coding_error, command.out_dir); !written)
      return report_failure(written.error());
  }
  return end_with_report(command.json, json_from(*source));
}

}  // namespace eigencast
