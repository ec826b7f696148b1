// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>

#include "common/core/clock.h"

namespace eigencast::broker {

/// The kernel's view of a TCP socket's peer.
struct PeerWindow {
  std::uint32_t bytes = 0;  ///< The window of its latest acknowledgement.
  TimeUs round_trip_us = 0;
};

/// Nothing where the kernel does not report it (Linux before 5.16) or `socket` is not a TCP socket.
std::optional<PeerWindow> peer_window(int socket);
/// Whether the connection is over for the kernel, whatever it says of bytes that are unacknowledged.
bool is_reset(int socket);

}  // namespace eigencast::broker
