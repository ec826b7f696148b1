// SPDX-License-Identifier: MIT
#include <spdlog/spdlog.h>

#include "common/core/files.h"
#include "sender/commands.h"
#include "sender/progress_line.h"

namespace eigencast {

Result<Source> bake_with_progress(const SourceOptions& options, const Console& console, Interrupt& interrupt) {
  ProgressLine line(console.progress, console.on_terminal);
  return bake_source(options, [&](double fraction, std::string_view stage) {
    line.show(fraction, stage, steady_now_us());
    return !interrupt.requested();
  });
}

int report_failure(const Error& error) {
  if (error.code == ErrorCode::kCancelled) {
    spdlog::info("interrupted");
  } else {
    spdlog::error("{}", error.message);
  }
  return kExitFailed;
}

Result<void> write_report(const std::string& path, const std::string& text) {
  return path.empty() ? Result<void>() : write_file_atomically(path, text + "\n");
}

}  // namespace eigencast
