// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <span>

#include "client/open_source.h"
#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// Writes a picture of each new pose, or as many as it can along a camera path, and a report.
/// `sources`: one for each of options.scene.streams, at least one. Returns an ExitCode; errors go to the log.
int run_headless(const ClientOptions& options, std::span<PoseSource* const> sources, const std::atomic<bool>& stop,
                 const LogSink& log);

/// Writes options.film, each picture at its time however long that takes: of clips to the bit the same again. Streams
/// are first kept for as long. Stopped, it ends the film with what is there. Returns an ExitCode: kExitFailed where a
/// sender went before the film's end, kExitStopped where it was stopped before. REQUIRES: options.film.
int run_film(const ClientOptions& options, const std::atomic<bool>& stop, const LogSink& log);

/// Shows the scene in a window, on the main thread; without sources it asks what to show. open: opens what a user asks
/// for.
int run_window(const ClientOptions& options, std::span<PoseSource* const> sources, const OpenSource& open,
               const std::atomic<bool>& stop, const LogSink& log);

inline ExitCode failed(const Error& error, const LogSink& log_sink) {
  log(log_sink, LogLevel::kError, error.message);
  return kExitFailed;
}

}  // namespace eigencast
