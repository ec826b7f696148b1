// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "broker/context/client_info.h"
#include "broker/context/context.h"

namespace eigencast::broker {

/// Totals of all event loops for the admin port: each loop adds its part on its own thread (Loops::for_each_loop).
struct Statistics {
  struct Made {
    std::uint64_t frames = 0;
    std::uint64_t poses_failed = 0;
    std::uint64_t profiles = 0;
  };

  void add(const Context& loop);
  /// Takes time in proportion to the clients.
  void add_clients(const Context& loop);
  Made made_of(const std::string& stream) const;  ///< Zeros for an unknown stream.

  Counters counters;
  std::vector<std::uint64_t> connections;  ///< Open connections of each loop.
  std::vector<ClientInfo> clients;
  std::map<std::string, Made, std::less<>> made;

  std::uint64_t connections_total() const;
};

}  // namespace eigencast::broker
