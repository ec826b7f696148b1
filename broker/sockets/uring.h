// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <span>

#include "broker/sockets/turn.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Writes for many connections with few system calls. Belongs to the thread that made it.
class Uring {
 public:
  /// Errors: kUnsupported (built without it, or the kernel refuses it).
  static Result<std::unique_ptr<Uring>> open();
  ~Uring();
  Uring(const Uring&) = delete;
  Uring& operator=(const Uring&) = delete;

  /// Flushes all writers, those with a plain socket in batches that are complete when the call returns.
  void write(std::span<Writer* const> writers);

 private:
  struct Ring;
  explicit Uring(std::unique_ptr<Ring> ring);
  std::unique_ptr<Ring> ring_;
};

}  // namespace eigencast::broker
