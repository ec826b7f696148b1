// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "tests/support/process.h"

namespace eigencast::testing {

/// A whole broker in this process, on a thread of its own, on loopback. It keeps its port and its assets over stop()
/// and start(). Throws std::runtime_error when it cannot start: a test cannot go on. Use from one thread.
class LoopbackBroker {
 public:
  explicit LoopbackBroker(int max_streams_per_connection = 64);
  ~LoopbackBroker();
  LoopbackBroker(const LoopbackBroker&) = delete;
  LoopbackBroker& operator=(const LoopbackBroker&) = delete;

  void start();
  void stop();
  /// Removes all assets. REQUIRES: stopped.
  void forget_assets();

  std::uint16_t port() const { return port_; }
  std::string url(const std::string& stream) const { return "ws://127.0.0.1:" + std::to_string(port_) + "/" + stream; }

 private:
  struct Running;
  const int max_streams_per_connection_;
  TemporaryFolder folder_;
  std::uint16_t port_ = 0;
  std::unique_ptr<Running> running_;
};

}  // namespace eigencast::testing
