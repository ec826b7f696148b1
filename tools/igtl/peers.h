// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "common/core/bytes.h"
#include "common/core/log.h"
#include "common/core/result.h"

namespace eigencast::igtl {

struct Endpoint {
  std::string host, port;
  std::string shown() const { return (host.find(':') == host.npos ? host : "[" + host + "]") + ":" + port; }
};

/// "18944", "host:18944", "[::1]:18944". Errors: kInvalidArgument.
///   host  where the text has none
Result<Endpoint> endpoint_from_text(const std::string& text, const std::string& host);

struct PeersOptions {
  bool listens = true;  ///< Else it connects, and again once a second.
  Endpoint where;
  std::size_t max_peers = 1;
  bool they_send = false;  ///< Where there is no room for one more, one that has been silent for kPatience goes.
};

/// TCP connections that neither wait for each other nor for anybody. A peer has one message being written and one that
/// waits: the newest; a peer that takes nothing for kPatience is disconnected. Not thread-safe.
class Peers {
 public:
  static constexpr std::chrono::seconds kPatience{10};
  /// What came from a peer, by its number; false: disconnect it.
  using OnBytes = std::function<bool(std::uint64_t peer, ByteView bytes)>;
  struct Stats {
    std::size_t connected = 0;
    std::uint64_t peers = 0;       ///< So far.
    std::uint64_t sent = 0;        ///< Messages, to each peer.
    std::uint64_t superseded = 0;  ///< Messages that a newer one replaced.
    bool writing = false;
  };

  /// Errors: kInvalidArgument (a host without address), kIo (the port is taken).
  static Result<std::unique_ptr<Peers>> create(PeersOptions options, LogSink log);
  virtual ~Peers() = default;

  /// Waits at most `timeout` for something to do, and does it.
  virtual void poll(std::chrono::milliseconds timeout, const OnBytes& on_bytes) = 0;
  /// For every peer that is connected.
  virtual void offer(const std::shared_ptr<const Bytes>& message) = 0;
  virtual Stats stats() const = 0;
};

}  // namespace eigencast::igtl
