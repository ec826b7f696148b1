// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <span>

#include "broker/connections/turn.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Writes for many connections with few system calls: a batch of sends is handed to the kernel and done when the call
/// returns, because none of them waits. Belongs to the thread that made it.
class Uring {
 public:
  /// Errors: kUnsupported (built without it, or the kernel refuses it).
  static Result<std::unique_ptr<Uring>> open();
  ~Uring();
  Uring(const Uring&) = delete;
  Uring& operator=(const Uring&) = delete;

  /// Each writes what is due, those with a plain socket in batches, and hears what became of it.
  void write(std::span<Leaver* const> leavers);

 private:
  struct Ring;
  explicit Uring(std::unique_ptr<Ring> ring);
  std::unique_ptr<Ring> ring_;
};

}  // namespace eigencast::broker
