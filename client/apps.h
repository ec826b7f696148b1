// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <span>

#include "client/open_source.h"
#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// Renders a picture of each new pose, or as many as it can along a camera path or around the scene, and writes
/// pictures and a report. Ends at options.frames, duration_s or `stop`. `sources`: one for each of
/// options.scene.streams, at least one. Returns an ExitCode; errors go to the log.
int run_headless(const ClientOptions& options, std::span<PoseSource* const> sources, const std::atomic<bool>& stop,
                 const LogSink& log);

/// Runs the viewer's window until it is closed, `stop` is set, or options.frames or duration_s are reached. `sources`:
/// one for each of options.scene.streams; without any the window asks what to show. open: opens what the user asks for.
/// Call from the main thread. Returns an ExitCode; errors go to the log.
int run_window(const ClientOptions& options, std::span<PoseSource* const> sources, const OpenSource& open,
               const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast
