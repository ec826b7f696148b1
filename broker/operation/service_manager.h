// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>

#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Listening sockets inherited from the service manager; -1: none. The caller owns them.
struct InheritedSockets {
  int data = -1;
  int admin = -1;
};

/// Protocol with systemd: sd_notify(3) and sd_listen_fds(3). Without one every call does nothing. Not thread-safe.
namespace service_manager {

/// The sockets named "data" and "admin" (FileDescriptorName=); a single unnamed one is data. Changes the environment:
/// call before threads are started.
/// Errors: kInvalidArgument (others than those, or not a listening TCP socket).
Result<InheritedSockets> inherited_sockets();

/// Reports lines of sd_notify(3), such as "READY=1\nSTATUS=...".
void notify(const std::string& state);
/// The longest period between reports of "WATCHDOG=1"; nothing: no watchdog.
std::optional<TimeUs> watchdog_us();

}  // namespace service_manager

}  // namespace eigencast::broker
