// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/surface/formats/write.h"
#include "sender/commands.h"
#include "sender/console.h"

namespace eigencast {

namespace {

/// Frames of another clip between those of this one would be read as its own.
Result<void> check_folder(const ExportCommand& command) {
  std::error_code none;
  const bool is_folder = command.to.ends_with('/') || std::filesystem::is_directory(command.to, none);
  if (command.force || !is_folder || !std::filesystem::exists(command.to, none)) return {};
  const auto first = std::filesystem::directory_iterator(command.to, none);
  if (none || first == std::filesystem::directory_iterator()) return {};
  return fail(ErrorCode::kInvalidArgument, command.to + ": holds files already, such as " +
                                               first->path().filename().string() +
                                               "; name another folder, or write among them with --force");
}

}  // namespace

int run(const ExportCommand& command, const Console& console, Interrupt& interrupt) {
  if (const auto usable = check_folder(command); !usable) return report_failure(usable.error());
  const auto clip = open_source(command.source);
  if (!clip) return report_failure(clip.error());
  for (const std::string& note : (*clip)->notes()) spdlog::info("{}", note);
  ProgressLine line(console.progress, stops_at(interrupt));
  const auto written =
      write_clip(**clip, command.to, [&](double fraction) { return line(fraction, "writing " + command.to); });
  line.finish();
  if (!written) return report_failure(written.error());
  spdlog::info("{}: {} poses of {} vertices", command.to, (*clip)->frame_count(), (*clip)->rest().vertex_count());
  const nlohmann::json report{{"input", command.source.input},
                              {"to", command.to},
                              {"frames", (*clip)->frame_count()},
                              {"vertices", (*clip)->rest().vertex_count()},
                              {"faces", (*clip)->rest().faces.size()},
                              {"rate_hz", (*clip)->frame_rate_hz()},
                              {"notes", (*clip)->notes()}};
  return end_with_report(command.json, report.dump(2));
}

}  // namespace eigencast
