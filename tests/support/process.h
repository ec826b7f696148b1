// SPDX-License-Identifier: MIT
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace eigencast::testing {

using std::chrono::milliseconds;

/// A folder of its own under the system's temporary folder, removed at the end.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  std::string file(const std::string& name) const { return (path_ / name).string(); }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// A child process whose standard output and error go to one file. Killed, and waited for, at the end. Not thread-safe.
class Process {
 public:
  /// Starts `arguments[0]`, a path or a name on PATH. Throws std::runtime_error when it cannot be started.
  Process(std::vector<std::string> arguments, std::string log_file);
  ~Process();
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void signal(int number) const;
  /// The exit status, or 128 + signal; nothing if it still runs after `timeout`.
  std::optional<int> wait(milliseconds timeout);
  bool running();
  /// All that it has written so far.
  std::string output() const;
  /// Waits until its output holds `text`.
  bool wait_for_output(const std::string& text, milliseconds timeout);
  pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = -1;
  std::optional<int> status_;
  std::string log_file_;
};

/// Waits until `condition` holds, polling every 20 ms; false if it did not within `timeout`.
template <typename Condition>
bool eventually(Condition condition, milliseconds timeout = milliseconds(20000));

void sleep_for(milliseconds time);

/// Whether PATH has this program.
bool on_path(const std::string& program);

template <typename Condition>
bool eventually(Condition condition, milliseconds timeout) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    sleep_for(milliseconds(20));
  }
  return true;
}

}  // namespace eigencast::testing
