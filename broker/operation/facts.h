// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "broker/context.h"
#include "broker/operation/client_facts.h"

namespace eigencast::broker {

/// What the admin port tells of all event loops together: each adds its part on its own thread (Loops::go_round).
struct Facts {
  /// What a stream's feeds made, in all loops.
  struct Made {
    std::uint64_t frames = 0;
    std::uint64_t poses_failed = 0;
    std::uint64_t profiles = 0;
  };

  void add(const Context& loop);
  /// Costs something for each client.
  void add_clients(const Context& loop);
  /// Of a stream that no loop has: nothing.
  Made made_of(const std::string& stream) const;

  Counters counters;
  std::vector<std::uint64_t> connections;  ///< Open ones, of each loop.
  std::vector<ClientFacts> clients;
  std::map<std::string, Made, std::less<>> made;

  std::uint64_t connections_total() const;
};

}  // namespace eigencast::broker
