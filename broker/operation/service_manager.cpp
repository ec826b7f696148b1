// SPDX-License-Identifier: MIT
#include "broker/operation/service_manager.h"

#include <netinet/in.h>
#include <sys/socket.h>
#include <systemd/sd-daemon.h>

#include <cstdlib>
#include <string_view>

namespace eigencast::broker::service_manager {

namespace {

bool listens_for_tcp(int fd) {
  int protocol = 0;
  socklen_t size = sizeof protocol;
  return sd_is_socket_inet(fd, AF_UNSPEC, SOCK_STREAM, 1, 0) > 0 &&
         ::getsockopt(fd, SOL_SOCKET, SO_PROTOCOL, &protocol, &size) == 0 && protocol == IPPROTO_TCP;
}

}  // namespace

Result<InheritedSockets> inherited_sockets() {
  char** names = nullptr;
  const int count = sd_listen_fds_with_names(1, &names);
  InheritedSockets inherited;
  Result<InheritedSockets> result(inherited);
  for (int i = 0; i < count; ++i) {
    const int fd = SD_LISTEN_FDS_START + i;
    const std::string_view name = names != nullptr ? names[i] : "";
    const bool first = name == "admin" ? inherited.admin < 0 : inherited.data < 0;
    if (!listens_for_tcp(fd)) {
      result = fail(ErrorCode::kInvalidArgument,
                    "the socket '" + std::string(name) +
                        "' that was handed over does not listen for TCP over IP: write ListenStream=ADDRESS:PORT");
    } else if (!first) {
      result = fail(ErrorCode::kInvalidArgument, "two sockets named '" + std::string(name) +
                                                     "' were handed over: the broker listens on one data socket and "
                                                     "one admin socket");
    } else if (name == "admin") {
      inherited.admin = fd;
    } else if (name == "data" || (count == 1 && (name.empty() || name == "unknown"))) {
      inherited.data = fd;
    } else {
      result = fail(ErrorCode::kInvalidArgument, "a socket named '" + std::string(name) +
                                                     "' was handed over: name it data or admin (FileDescriptorName=)");
    }
  }
  for (int i = 0; names != nullptr && i < count; ++i) std::free(names[i]);
  std::free(names);
  if (result) result = inherited;
  return result;
}

void notify(const std::string& state) {
  sd_notify(0, state.c_str());
}

std::optional<TimeUs> watchdog_us() {
  std::uint64_t period_us = 0;
  if (sd_watchdog_enabled(0, &period_us) <= 0) return std::nullopt;
  return static_cast<TimeUs>(period_us);
}

}  // namespace eigencast::broker::service_manager
