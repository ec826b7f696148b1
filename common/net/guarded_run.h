// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <exception>
#include <string>
#include <thread>

namespace eigencast {

/// Runs `body`, the work of a thread of ours, until it returns. An exception that leaves it (memory ran out, or a
/// callback of the caller's threw) must not end the process: `failed(text)` hears what it was, and `body` runs again
/// after a short pause. Where `failed` throws too it is tried a few times more, then given up on.
template <typename Body, typename Failed>
void guarded_run(Body&& body, Failed&& failed) {
  constexpr std::chrono::milliseconds kPause{10};
  constexpr int kTries = 10;
  const auto report = [&](const char* what) {
    for (int i = 0; i < kTries; ++i) {
      try {
        return failed("internal error: " + std::string(what));
      } catch (...) {
        std::this_thread::sleep_for(kPause);
      }
    }
  };
  while (true) {
    try {
      return body();
    } catch (const std::exception& error) {
      report(error.what());
    } catch (...) {
      report("an exception of unknown type");
    }
    std::this_thread::sleep_for(kPause);
  }
}

}  // namespace eigencast
