// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>

#include "common/core/clock.h"

namespace eigencast::broker {

/// What the kernel knows of a TCP socket's peer.
struct PeerWindow {
  std::uint32_t bytes = 0;  ///< It offers to take so much, by its latest acknowledgement.
  TimeUs round_trip_us = 0;
};

/// Nothing where the kernel does not tell (Linux before 5.16) or `socket` is no TCP socket.
std::optional<PeerWindow> peer_window(int socket);

}  // namespace eigencast::broker
