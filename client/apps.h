// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <span>

#include "client/open_source.h"
#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// Renders each new pose, or along a camera path or round the scene as many pictures as it can, into memory and writes
/// pictures and a report, until options.frames or duration_s are reached or `stop` is set. `sources`: one for each of
/// options.scene.streams, at least one. Returns an ExitCode; errors go to the log.
int run_headless(const ClientOptions& options, std::span<PoseSource* const> sources, const std::atomic<bool>& stop,
                 const LogSink& log);

/// Opens the viewer's window and runs it until it is closed, `stop` is set, or options.frames or duration_s are
/// reached. `sources`: one for each of options.scene.streams; none: it welcomes its user. open: how it opens what the
/// user asks for. Call from the main thread. Returns an ExitCode; errors go to the log.
int run_window(const ClientOptions& options, std::span<PoseSource* const> sources, const OpenSource& open,
               const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast
