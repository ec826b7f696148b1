// SPDX-License-Identifier: MIT
#pragma once

#include <functional>

#include "broker/config/config.h"
#include "broker/sockets/net.h"
#include "common/core/log.h"
#include "common/core/result.h"

namespace eigencast::broker {

/// Accepts connections on one address. Belongs to its event loop; destroy it after the loop has ended.
class Listener {
 public:
  using OnConnection = std::function<void(Socket)>;

  Listener(asio::io_context& loop, LogSink log, OnConnection on_connection);

  Result<void> open(const Address& address);
  /// Takes over a listening socket. Errors of both: kUnreachable.
  Result<void> adopt(int listening);
  void close();
  bool is_open() const { return acceptor_.is_open(); }
  std::uint16_t port() const { return port_; }

 private:
  void accept();

  asio::io_context& loop_;
  LogSink log_;
  OnConnection on_connection_;
  Acceptor acceptor_;
  Timer pause_;
  std::uint16_t port_ = 0;
};

}  // namespace eigencast::broker
