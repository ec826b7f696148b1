// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>

#include "common/core/clock.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Sockets that whoever started the process listens on already; -1: none. Owned by who takes them.
struct GivenSockets {
  int data = -1;
  int admin = -1;
};

/// What systemd (or anything that speaks its protocol, sd_notify(3) and sd_listen_fds(3)) has to hear and gives.
/// Without it every call does nothing. Not thread-safe; take_sockets() changes the environment: before threads are
/// started.
namespace service_manager {

/// The sockets named "data" and "admin" (FileDescriptorName=); a single unnamed one is data.
/// Errors: kInvalidArgument (others than those, or not a listening TCP socket).
Result<GivenSockets> take_sockets();

void ready(const std::string& status);
void reloading(TimeUs now_us);
void stopping();
void status(const std::string& status);
/// The process is alive: the loop turns.
void alive();
/// How often alive() must be called at least; nothing: never.
std::optional<TimeUs> watchdog_us();

}  // namespace service_manager

}  // namespace eigencast::broker
