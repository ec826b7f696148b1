// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>

#include "client/options.h"
#include "client/pose_source.h"

namespace eigencast {

/// Renders each new pose into memory and writes pictures and a report, until options.frames or duration_s are reached
/// or `stop` is set. Returns an ExitCode; errors go to the log.
int run_headless(const ClientOptions& options, PoseSource& source, const std::atomic<bool>& stop, const LogSink& log);

/// Opens the viewer's window and runs it until it is closed, `stop` is set, or options.frames or duration_s are
/// reached. Call from the main thread. Returns an ExitCode; errors go to the log.
int run_window(const ClientOptions& options, PoseSource& source, const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast
