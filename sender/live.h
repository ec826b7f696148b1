// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "sdk/publisher.h"
#include "sender/commands.h"

/// What the commands share that send poses to a broker.
namespace eigencast {

LogSink to_log();

/// Connecting has begun. It learns nothing yet. Errors: kInvalidArgument (codec, URL, error).
Result<std::unique_ptr<Publisher>> publish(const TargetOptions& target, double rate_hz,
                                           std::shared_ptr<const Asset> asset,
                                           std::shared_ptr<const EncodedAsset> encoded, bool velocities = false);

void log_bake(const BakeResult& baked);
/// What opening it changed, and which files of its look are missing.
void log_clip(const MotionClip& clip);

/// The stream goes on with all of its basis, or stays as it is, and the log says why.
void go_over(Publisher& publisher, const BakeResult& whole, std::shared_ptr<const Asset> asset,
             std::shared_ptr<const EncodedAsset> encoded);
void stay_coarse(const Error& why);

/// False if interrupted, no longer ours, or the steady clock shows `deadline_us` (0: no end).
bool wait_until_live(const Publisher& publisher, TimeUs deadline_us, Interrupt& interrupt);

/// Errors: kRefused: the broker has given the stream to another sender, for good.
Result<void> check_ownership(const Publisher& publisher);

/// Checks URL, credentials and codec and probes the broker, before anything that takes long. An absent broker is a
/// warning, since it may start meanwhile. kExitOk, or the status to end with, after the log has said why.
ExitCode check_target(const TargetOptions& target, bool velocities = false);

class StatusLog {
 public:
  explicit StatusLog(TimeUs now_us) : shown_us_(now_us) {}
  void show(const Publisher& publisher, TimeUs now_us);

 private:
  Publisher::Stats last_;
  TimeUs shown_us_;
};

/// Draws a pose (r x 3) as viewers do, into a PNG. Errors: kUnsupported (this build, or this machine, draws nothing),
/// kIo. REQUIRES: asset.complete().
Result<void> write_thumbnail(const Asset& asset, std::span<const double> C, const std::string& path);

/// Errors: kUnsupported (no display, or a build without windows).
Result<void> find_display();

/// Until the window is closed or the duration is over. Gives the report as JSON. Errors: as find_display().
Result<std::string> deform_by_hand(const DeformCommand& command, deform::Deformer& deformer,
                                   deform::ProjectedDeformer& projected, const Asset& asset, Publisher& publisher,
                                   Interrupt& interrupt);

}  // namespace eigencast
