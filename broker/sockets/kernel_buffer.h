// SPDX-License-Identifier: MIT
#pragma once

namespace eigencast::broker {

enum class KernelBuffer : int { kSend = 1, kReceive = 2 };  ///< As in linux/socket.h.

/// Fixes the size of a socket's buffer as it is, as SO_SNDBUF and SO_RCVBUF do, or lets the kernel choose from there
/// on. False: nothing has changed, as always before Linux 5.14.
bool fix_buffer(int socket, KernelBuffer which, bool fixed);

}  // namespace eigencast::broker
