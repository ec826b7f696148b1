// SPDX-License-Identifier: MIT
#include "broker/sockets/kernel_buffer.h"

#include <sys/socket.h>

namespace eigencast::broker {

bool fix_buffer(int socket, KernelBuffer which, bool fixed) {
#ifdef SO_BUF_LOCK
  int locks = 0;
  socklen_t size = sizeof locks;
  if (::getsockopt(socket, SOL_SOCKET, SO_BUF_LOCK, &locks, &size) != 0) return false;
  locks = fixed ? locks | static_cast<int>(which) : locks & ~static_cast<int>(which);
  return ::setsockopt(socket, SOL_SOCKET, SO_BUF_LOCK, &locks, sizeof locks) == 0;
#else
  return false;
#endif
}

}  // namespace eigencast::broker
