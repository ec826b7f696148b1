// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/surface/formats/morph.h"
#include "common/surface/formats/write.h"
#include "sender/clip_part.h"
#include "sender/commands.h"
#include "sender/console.h"
#include "sender/morph_targets.h"
#include "sender/source.h"

namespace eigencast {

namespace {

bool is_morphed(const std::string& path) {
  return path.ends_with(".glb");
}

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

Result<void> write_targets(const MotionClip& clip, const ExportCommand& command, const WriteProgress& progress,
                           nlohmann::json& report) {
  const auto made = morph_targets_of(clip, static_cast<std::size_t>(command.targets), progress);
  if (!made) return made.error();
  spdlog::info("{} morph targets: rms error {:.2e}, largest {:.2e} of the diagonal", made->motion.targets,
               made->rms_error, made->largest_error);
  report["targets"] = made->motion.targets;
  report["rms_error"] = made->rms_error;
  report["largest_error"] = made->largest_error;
  return write_morphed(clip, made->motion, command.to);
}

}  // namespace

int run(const ExportCommand& command, const Console& console, Interrupt& interrupt) {
  if (const auto usable = check_folder(command); !usable) return report_failure(usable.error());
  SourceOptions options = command.source;
  if (command.part.rate_hz > 0) options.sample_rate_hz = command.part.rate_hz;
  auto opened = open_source(options);
  if (!opened) return report_failure(opened.error());
  const auto clip = part_of(*std::move(opened), command.part);
  if (!clip) return report_failure(clip.error());
  for (const std::string& note : (*clip)->notes()) spdlog::info("{}", note);
  nlohmann::json report{{"input", command.source.input},
                        {"to", command.to},
                        {"frames", (*clip)->frame_count()},
                        {"vertices", (*clip)->rest().vertex_count()},
                        {"faces", (*clip)->rest().faces.size()},
                        {"rate_hz", (*clip)->frame_rate_hz()},
                        {"notes", (*clip)->notes()}};
  ProgressLine line(console.progress, stops_at(interrupt));
  const auto progress = [&](double fraction) { return line(fraction, "writing " + command.to); };
  const auto written = is_morphed(command.to) ? write_targets(**clip, command, progress, report)
                                              : write_clip(**clip, command.to, progress);
  line.finish();
  if (!written) return report_failure(written.error());
  spdlog::info("{}: {} poses of {} vertices", command.to, (*clip)->frame_count(), (*clip)->rest().vertex_count());
  return end_with_report(command.json, report.dump(2));
}

}  // namespace eigencast
