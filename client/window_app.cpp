// SPDX-License-Identifier: MIT
#include "client/apps.h"
#include "client/viewer.h"
#include "common/core/files.h"
#include "common/core/timers.h"

namespace eigencast {
namespace {

Result<void> write_results(Viewer& viewer, const ClientOptions& options) {
  if (!options.screenshot.empty()) {
    if (Result<void> written = viewer.save(options.screenshot); !written) return written;
  }
  return options.json.empty() ? Result<void>() : write_file_atomically(options.json, viewer.report());
}

}  // namespace

int run_window(const ClientOptions& options, std::span<PoseSource* const> sources, const OpenSource& open,
               const std::atomic<bool>& stop, const LogSink& log_sink) {
  Viewer viewer(options, open, log_sink);
  if (const Result<void> ready = viewer.open(sources); !ready) {
    log(log_sink, LogLevel::kError, ready.error().message);
    return kExitFailed;
  }
  // Not before: what draws beside this thread, where a processor does, shall not be like it.
  run_when_woken(kMakingPoses);
  const TimeUs start = steady_now_us();
  while (!stop.load() && !viewer.closed()) {
    if (options.duration_s > 0 && static_cast<double>(steady_now_us() - start) / 1e6 >= options.duration_s) break;
    if (options.frames > 0 && viewer.session().scene().poses_shown() >= options.frames) break;
    viewer.turn();
  }
  // What cannot be remembered is a pity and no failure.
  if (const Result<void> remembered = viewer.remember(); !remembered)
    log(log_sink, LogLevel::kWarning, remembered.error().message);
  if (const Result<void> written = write_results(viewer, options); !written) {
    log(log_sink, LogLevel::kError, written.error().message);
    return kExitFailed;
  }
  return kExitGood;
}

}  // namespace eigencast
