// SPDX-License-Identifier: MIT
#include <signal.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <functional>

#include "common/core/files.h"
#include "common/core/text.h"
#include "sender/commands.h"
#include "sender/live.h"
#include "sender/source.h"

namespace eigencast {
namespace {

sigset_t our_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  return set;
}

}  // namespace

Interrupt::Interrupt() {
  const sigset_t set = our_signals();
  // A shell's background job starts with SIGINT ignored, and an ignored signal is never pending.
  signal(SIGINT, SIG_DFL);
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
  sleep_on_time();
  run_when_woken(kMakingPoses);
}

bool Interrupt::wait_until(TimeUs deadline_us) {
  const sigset_t set = our_signals();
  while (!requested_) {
    const TimeUs left_us = std::max<TimeUs>(0, deadline_us - steady_now_us());
    const timespec timeout{left_us / 1'000'000, (left_us % 1'000'000) * 1000};
    if (sigtimedwait(&set, nullptr, &timeout) > 0)
      requested_ = true;
    else if (errno == EAGAIN)
      break;
  }
  return requested_;
}

Result<Source> bake_with_progress(const SourceOptions& options, const Console& console, Interrupt& interrupt,
                                  OpenedSource opened) {
  ProgressLine line(console.progress, stops_at(interrupt));
  auto source = bake_source(options, std::ref(line), std::move(opened));
  line.finish();
  if (!source) return source;
  log_bake(source->baked);
  log_clip(*source->clip);
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
  // Written here under its own name, too: through another descriptor it would lie beneath the program's
  // other output.
  if (path != "-" && path != "/dev/stdout") return write_file_atomically(path, text + "\n");
  const bool written = std::fputs((text + "\n").c_str(), stdout) >= 0 && std::fflush(stdout) == 0;
  return written ? Result<void>() : fail(ErrorCode::kIo, "standard output cannot be written");
}

int end_with_report(const std::string& path, const std::string& text) {
  const auto written = write_report(path, text);
  return written ? kExitOk : report_failure(written.error());
}

}  // namespace eigencast
