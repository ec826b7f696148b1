// SPDX-License-Identifier: MIT
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>

#include "common/core/result.h"

namespace eigencast::latency {

/// The broker that is installed beside this program, as a process of its own on a free port of loopback, with a data
/// folder that is removed with it: the default without a URL.
class LocalBroker {
 public:
  /// Errors: kNotFound (no eigencast-broker beside this program), kIo, kTimeout (it does not listen).
  static Result<std::unique_ptr<LocalBroker>> start();
  ~LocalBroker();
  LocalBroker(const LocalBroker&) = delete;
  LocalBroker& operator=(const LocalBroker&) = delete;
  std::string url(const std::string& stream) const { return "ws://127.0.0.1:" + port_ + "/" + stream; }

 private:
  LocalBroker(pid_t pid, std::string folder) : pid_(pid), folder_(std::move(folder)) {}
  pid_t pid_;
  std::string folder_, port_;
};

}  // namespace eigencast::latency
