// SPDX-License-Identifier: MIT
#include "broker/sockets/peer_window.h"

#include <linux/tcp.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cstddef>

namespace eigencast::broker {

std::optional<PeerWindow> peer_window(int socket) {
  tcp_info info{};
  socklen_t size = sizeof info;
  if (::getsockopt(socket, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return std::nullopt;
  if (size < offsetof(tcp_info, tcpi_snd_wnd) + sizeof info.tcpi_snd_wnd) return std::nullopt;
  return PeerWindow{info.tcpi_snd_wnd, info.tcpi_rtt};
}

bool is_reset(int socket) {
  tcp_info info{};
  socklen_t size = sizeof info;
  constexpr std::uint8_t kClose = 7;  // TCP_CLOSE of netinet/tcp.h, which does not go with linux/tcp.h.
  return ::getsockopt(socket, IPPROTO_TCP, TCP_INFO, &info, &size) == 0 && info.tcpi_state == kClose;
}

}  // namespace eigencast::broker
