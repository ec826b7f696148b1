// SPDX-License-Identifier: MIT
#include "tools/latency/local_broker.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

extern char** environ;

namespace eigencast::latency {

Result<std::unique_ptr<LocalBroker>> LocalBroker::start() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  std::string program = (self.parent_path() / "eigencast-broker").string();
  if (error || !std::filesystem::exists(program))
    return fail(ErrorCode::kNotFound, program + ": there is no broker beside this program: give the URL of one");
  std::string folder = (std::filesystem::temp_directory_path() / "eigencast-latency-XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr) return fail(ErrorCode::kIo, folder + ": cannot be made");
  std::array<std::string, 7> words{program,          "--listen",   "127.0.0.1:0",   "--port-file",
                                   folder + "/port", "--data-dir", folder + "/data"};
  std::array<char*, 8> arguments{};
  for (std::size_t i = 0; i < words.size(); ++i) arguments[i] = words[i].data();
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, (folder + "/log").c_str(), O_WRONLY | O_CREAT, 0600);
  posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes,
                           POSIX_SPAWN_SETPGROUP);  // Ctrl-C is for us: we end the broker when we are done.
  pid_t pid = -1;
  const int failed = posix_spawn(&pid, program.c_str(), &actions, &attributes, arguments.data(), environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  if (failed != 0) return fail(ErrorCode::kIo, program + ": cannot be started");
  std::unique_ptr<LocalBroker> broker(new LocalBroker(pid, folder));
  for (int i = 0; i < 500; ++i) {
    std::ifstream(folder + "/port") >> broker->port_;
    if (!broker->port_.empty()) return broker;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return fail(ErrorCode::kTimeout, program + ": does not listen");
}

LocalBroker::~LocalBroker() {
  kill(pid_, SIGTERM);
  int status = 0;
  for (int i = 0; i < 200 && waitpid(pid_, &status, WNOHANG) == 0; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  if (waitpid(pid_, &status, WNOHANG) == 0) {
    kill(pid_, SIGKILL);
    waitpid(pid_, &status, 0);
  }
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

}  // namespace eigencast::latency
