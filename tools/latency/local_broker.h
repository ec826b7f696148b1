// SPDX-License-Identifier: MIT
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>

#include "common/core/result.h"

namespace eigencast::latency {

/// The broker beside this program, as a process of its own on a free port of loopback; its data go with it.
class LocalBroker {
 public:
  /// Errors: kNotFound (no such program), kIo, kTimeout (it does not listen).
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
