// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/core/clock.h"

namespace eigencast::broker {

/// What the admin API reports about one WebSocket.
struct ClientInfo {
  enum class Kind : std::uint8_t { kSender, kViewer };
  Kind kind = Kind::kViewer;
  std::uint64_t id = 0;
  std::string who;  ///< Token's subject and address; not secret.
  TimeUs connected_us = 0;
  struct Watched {
    std::string stream;
    std::string profile;   ///< In use; empty: it is the sender.
    std::size_t rung = 0;  ///< Steps of the ladder below the requested profile.
  };
  std::vector<Watched> streams;
  std::optional<TimeUs> round_trip_us;  ///< Least recent time from a frame to its acknowledgement.
  bool acknowledges = false;
  std::uint64_t frames_sent = 0;
  std::uint64_t bytes_sent = 0;
  std::uint64_t skipped = 0;
  std::uint64_t joins = 0;
  std::uint64_t control_waiting = 0;
};

}  // namespace eigencast::broker
