// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "sdk/publisher.h"
#include "sender/commands.h"

/// What the commands share that send poses to a broker.
namespace eigencast {

/// Messages of the sdk go to the program's log.
LogSink to_log();

/// A publisher of the baked asset, whose bytes it takes over; connecting has begun. Its messages go to the log.
///   asset  baked.asset, shared
/// Errors: kInvalidArgument (codec, URL, error).
Result<std::unique_ptr<Publisher>> publish(const TargetOptions& target, double rate_hz,
                                           std::shared_ptr<const Asset> asset, EncodedAsset encoded,
                                           bool velocities = false);

/// Waits until the broker takes poses or the steady clock shows `deadline_us` (0: no end). False if interrupted, too
/// late, or no longer ours.
bool wait_until_live(const Publisher& publisher, TimeUs deadline_us, Interrupt& interrupt);

/// Whether the stream is still this sender's. Errors: kRefused once the broker has given it to another one, for good.
Result<void> check_ownership(const Publisher& publisher);

/// Checks a target before anything that takes long: its URL, the files of its credentials, its codec; and probes the
/// broker. An absent broker is a warning only, since it may start meanwhile. kExitOk, or the status to end with, after
/// the log has said why.
ExitCode check_target(const TargetOptions& target, bool velocities = false);

/// Every ten seconds a line in the log: poses a second, bit rate, viewers.
class StatusLog {
 public:
  explicit StatusLog(TimeUs now_us) : shown_us_(now_us) {}
  void show(const Publisher& publisher, TimeUs now_us);

 private:
  Publisher::Stats last_;
  TimeUs shown_us_;
};

}  // namespace eigencast
