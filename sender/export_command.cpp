// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/surface/formats/morph.h"
#include "common/surface/formats/write.h"
#include "sdk/asset_cache.h"
#include "sdk/recorded_clip.h"
#include "sender/clip_part.h"
#include "sender/clip_recording.h"
#include "sender/commands.h"
#include "sender/console.h"
#include "sender/cut.h"
#include "sender/live.h"
#include "sender/morph_targets.h"
#include "sender/page_file.h"
#include "sender/source.h"

namespace eigencast {

namespace {

bool is_morphed(const std::string& path) {
  return path.ends_with(".glb");
}

bool is_page(const std::string& path) {
  return path.ends_with(".html");
}

/// What is being written, beside the file that it becomes; removed at the end.
struct Scratch {
  explicit Scratch(const std::string& to) : path(to + ".part") { remove(); }
  ~Scratch() { remove(); }
  void remove() const {
    std::error_code ignored;
    std::filesystem::remove(path, ignored);
  }
  std::string path;
};

/// What states curves, at that rate of theirs.
Result<std::unique_ptr<MotionClip>> open_at_rate(const ExportCommand& command) {
  SourceOptions options = command.source;
  if (command.part.rate_hz > 0) options.sample_rate_hz = command.part.rate_hz;
  return open_source(options);
}

/// Of a recording its own poses, as they are coded.
Result<void> record(const ExportCommand& command, const std::string& to, const Console& console, Interrupt& interrupt) {
  const ClipPart& part = command.part;
  if (is_recording(command.source.input)) {
    if (part.level < 1)
      return fail(ErrorCode::kInvalidArgument, "poses of a recording stay as they are coded: leave --level out");
    const AssetCache cache(default_cache_dir());
    const auto cut = cut_recordings({command.source.input}, part.from_s, part.duration_s, part.rate_hz, to,
                                    [&](const Sha256& id) -> Result<Bytes> {
                                      auto cached = cache.load(id);
                                      if (cached) return *std::move(cached);
                                      return fail(ErrorCode::kNotFound, "not in the cache");
                                    });
    return cut ? Result<void>() : cut.error();
  }
  std::error_code code;
  if (std::filesystem::exists(to, code))
    return fail(ErrorCode::kInvalidArgument, to + ": is there already; name another file");
  auto opened = open_at_rate(command);
  if (!opened) return opened.error();
  auto clip = part_of(*std::move(opened), part);
  if (!clip) return clip.error();
  const auto source = bake_with_progress(command.source, console, interrupt, {*std::move(clip)});
  if (!source) return source.error();
  ProgressLine line(console.progress, stops_at(interrupt));
  const Scratch scratch(to);
  const auto recorded = record_clip(*source->clip, source->baked, scratch.path, std::ref(line));
  line.finish();
  if (!recorded) return recorded;
  std::filesystem::rename(scratch.path, to, code);
  if (code) return fail(ErrorCode::kIo, to + ": cannot be written: " + code.message());
  return {};
}

Result<void> write_recording(const ExportCommand& command, const Console& console, Interrupt& interrupt) {
  if (!is_page(command.to)) return record(command, command.to, console, interrupt);
  const Scratch scratch(command.to + ".ecrec");
  if (const auto recorded = record(command, scratch.path, console, interrupt); !recorded) return recorded;
  ProgressLine line(console.progress, stops_at(interrupt));
  const auto written =
      write_page(scratch.path, command.to, [&](double fraction) { return line(fraction, "writing " + command.to); });
  line.finish();
  return written;
}

/// A file that would be written over; empty: none.
std::string file_in_the_way(const std::string& to) {
  namespace fs = std::filesystem;
  std::error_code none;
  const fs::path path(to);
  const std::string ending = path.extension().string();
  if (ending != ".obj" && ending != ".ply" && ending != ".off") return fs::exists(path, none) ? to : std::string();
  const std::string start = path.stem().string() + "_";
  constexpr std::size_t kDigits = 6;
  for (const auto& entry : fs::directory_iterator(path.has_parent_path() ? path.parent_path() : ".", none)) {
    const std::string name = entry.path().filename().string();
    const bool fits = name.starts_with(start) && name.ends_with(ending) &&
                      name.size() == start.size() + kDigits + ending.size() &&
                      name.find_first_not_of("0123456789", start.size()) == start.size() + kDigits;
    if (fits) return entry.path().string();
  }
  return {};
}

/// Frames of another clip between those of this one would be read as its own.
Result<void> check_there(const ExportCommand& command) {
  std::error_code none;
  const bool is_folder = command.to.ends_with('/') || std::filesystem::is_directory(command.to, none);
  if (const std::string there = command.force || is_folder ? "" : file_in_the_way(command.to); !there.empty())
    return fail(ErrorCode::kInvalidArgument,
                there + ": is there already; name another file, or write over it with --force");
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
  if (const auto usable = check_there(command); !usable) return report_failure(usable.error());
  if (is_page(command.to) || is_recording(command.to)) {
    if (const auto written = write_recording(command, console, interrupt); !written)
      return report_failure(written.error());
    std::error_code ignored;
    const auto bytes = std::filesystem::file_size(command.to, ignored);
    spdlog::info("{}: {} bytes", command.to, bytes);
    const nlohmann::json report{{"input", command.source.input}, {"to", command.to}, {"bytes", bytes}};
    return end_with_report(command.json, report.dump(2));
  }
  auto opened = open_at_rate(command);
  if (!opened) return report_failure(opened.error());
  const auto clip = part_of(*std::move(opened), command.part);
  if (!clip) return report_failure(clip.error());
  log_clip(**clip);
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
