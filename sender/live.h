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

/// Errors: kRefused once the broker has given the stream to another sender: nothing is tried again then.
Result<void> still_ours(const Publisher& publisher);

/// All that can be told of a target before anything that takes long begins: its URL, the files of its credentials,
/// codings that do not go together; and whether the broker is there and lets us in. One that is not there is warned of
/// only, since it may come meanwhile. kExitOk, or the status to end with, when the log says why.
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

/// "sent", "dropped", "disconnected"
std::string_view name_of(SendStatus status);

}  // namespace eigencast
