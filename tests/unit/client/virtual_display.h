// SPDX-License-Identifier: MIT
#pragma once

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <string>

namespace eigencast::testing {

/// An X server without a screen, and without this extension, for the time of one test.
class VirtualDisplay {
 public:
  explicit VirtualDisplay(const char* without = "COMPOSITE") {
    int ends[2];
    if (::pipe(ends) != 0) return;
    pid_ = ::fork();
    if (pid_ == 0) {
      const std::string fd = std::to_string(ends[1]);
      ::close(ends[0]);
      ::execlp("Xvfb", "Xvfb", "-displayfd", fd.c_str(), "-screen", "0", "800x600x24", "-nolisten", "tcp", "-noreset",
               "-extension", without, static_cast<char*>(nullptr));
      ::_exit(127);
    }
    ::close(ends[1]);
    from_server_ = ends[0];
    // The number and its newline may come apart, and the server dies if nobody is there to take both.
    std::string text;
    for (char c = 0; c != '\n' && ::read(from_server_, &c, 1) == 1;) text += c;
    if (!text.empty()) number_ = std::atoi(text.c_str());
  }
  ~VirtualDisplay() {
    if (from_server_ >= 0) ::close(from_server_);
    if (pid_ <= 0) return;
    ::kill(pid_, SIGTERM);
    ::waitpid(pid_, nullptr, 0);
  }
  bool ready() const { return number_ >= 0; }
  std::string name() const { return ":" + std::to_string(number_); }

 private:
  pid_t pid_ = -1;
  int number_ = -1, from_server_ = -1;
};

}  // namespace eigencast::testing
