// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "tests/support/impaired_path.h"

namespace eigencast::testing {

/// A TCP relay on loopback that behaves like a bad link: whatever connects to it is connected to `target_port`, each
/// direction through an ImpairedPath that all connections share. It holds back its readers rather than queue more than
/// a router would.
///
/// Own error of the delays: the wake-up of its thread, below 1 ms on a machine that is not overloaded. Runs one thread;
/// use from one.
class ImpairedRelay {
 public:
  struct Options {
    std::uint16_t target_port = 0;  ///< On 127.0.0.1.
    std::uint16_t port = 0;         ///< Listens on 127.0.0.1; 0: any free one.
    Impairment to_target;           ///< From the client to the target.
    Impairment from_target;         ///< And back.
    TimeUs max_queued_us =
        200'000;  ///< A rate-limited link holds at most so much of its own bandwidth (default: 200 ms).
  };

  /// Listens. Errors: kInvalidArgument (impairments), kUnreachable (cannot listen).
  static Result<std::unique_ptr<ImpairedRelay>> start(const Options& options);
  ~ImpairedRelay();  ///< Cuts all connections.
  ImpairedRelay(const ImpairedRelay&) = delete;
  ImpairedRelay& operator=(const ImpairedRelay&) = delete;

  std::uint16_t port() const;
  std::string url(const std::string& stream) const { return "ws://127.0.0.1:" + std::to_string(port()) + "/" + stream; }
  /// Bytes that were written to the client, and to the target.
  std::uint64_t bytes_from_target() const;
  std::uint64_t bytes_to_target() const;

 private:
  class Impl;
  explicit ImpairedRelay(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace eigencast::testing
