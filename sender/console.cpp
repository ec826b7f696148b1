// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include <cstdio>
#include <functional>

#include "common/core/files.h"
#include "sender/commands.h"
#include "sender/progress_line.h"
#include "sender/target_error.h"

namespace eigencast {

Result<Source> bake_with_progress(const SourceOptions& options, const Console& console, Interrupt& interrupt,
                                  OpenedSource opened) {
  ProgressLine line(console.progress, interrupt);
  auto source = options.target_error > 0 ? bake_for_target(options, std::ref(line))
                                         : bake_source(options, std::ref(line), std::move(opened));
  line.finish();
  if (!source) return source;
  if (source->rank_choice) spdlog::info("{}", source->rank_choice->text(options.target_error));
  if (!source->baked.not_kept.empty()) spdlog::warn("the bake is not kept: {}", source->baked.not_kept);
  for (const std::string& note : source->clip->notes()) spdlog::info("{}", note);
  for (const std::string& finding : source->findings) spdlog::warn("{}", finding);
  return source;
}

int report_failure(const Error& error) {
  if (error.code == ErrorCode::kCancelled) {
    spdlog::info("interrupted");
  } else {
    spdlog::error("{}", error.message);
  }
  const bool no_broker = error.code == ErrorCode::kUnreachable || error.code == ErrorCode::kRefused ||
                         error.code == ErrorCode::kDisconnected;
  return no_broker ? kExitUnreachable : kExitFailed;
}

Result<void> write_report(const std::string& path, const std::string& text) {
  if (path.empty()) return {};
  // By its own name, too: through another descriptor it would lie beneath what else the program prints into a file.
  if (path != "-" && path != "/dev/stdout") return write_file_atomically(path, text + "\n");
  const bool written = std::fputs((text + "\n").c_str(), stdout) >= 0 && std::fflush(stdout) == 0;
  return written ? Result<void>() : fail(ErrorCode::kIo, "standard output cannot be written");
}

int end_with_report(const std::string& path, const std::string& text) {
  const auto written = write_report(path, text);
  return written ? kExitOk : report_failure(written.error());
}

}  // namespace eigencast
