// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "broker/backbone/link.h"

namespace eigencast::broker {

struct NatsSettings {
  std::vector<std::string> servers;        ///< nats://HOST:PORT, tls://HOST:PORT
  std::string name;                        ///< This broker's name in the server's lists.
  std::string prefix = "eigencast";        ///< Prefix of the bucket and of the subject of row changes.
  int replicas = 1;                        ///< Replicas of the table if this broker creates it: 1, 3 or 5.
  std::string ca_file;                     ///< CA certificates for the servers; empty: the system's.
  std::string certificate_file, key_file;  ///< This broker's; empty: none.
  std::string credentials_file;            ///< A .creds file; empty: none.
  std::string user, password, token;       ///< Empty: none.
};

/// A Link over NATS: subjects and requests of core NATS, and a JetStream key-value bucket as the table.
///   on_loop  runs work on the event loop; thread-safe
/// Errors: kInvalidArgument, kIo (options refused by libnats).
Result<std::shared_ptr<Link>> make_nats_link(const NatsSettings& settings,
                                             std::function<void(std::function<void()>)> on_loop);

}  // namespace eigencast::broker
