// SPDX-License-Identifier: MIT
#include "broker/sockets/listener.h"

#include <boost/asio/ip/address.hpp>
#include <utility>

#include "broker/sockets/kernel_buffer.h"
#include "broker/sockets/transport.h"

namespace eigencast::broker {
namespace {

// The kernel doubles it.
const asio::socket_base::receive_buffer_size kReceiveOption(Transport::kReceiveBytes / 2);

/// Connections begin with what it has. A fixed size would allow none of them a window of more than 64 KiB, whatever
/// they get later: its scale (RFC 7323) is said once, as they begin.
void narrow(Acceptor& acceptor) {
  if (!fix_buffer(acceptor.native_handle(), KernelBuffer::kReceive, false)) return;
  ErrorOf ignored;
  acceptor.set_option(kReceiveOption, ignored);
  (void)fix_buffer(acceptor.native_handle(), KernelBuffer::kReceive, false);
}

}  // namespace

Listener::Listener(asio::io_context& loop, LogSink log, OnConnection on_connection)
    : loop_(loop),
      log_(std::move(log)),
      on_connection_(std::move(on_connection)),
      acceptor_(loop.get_executor()),
      pause_(loop.get_executor()) {}

Result<void> Listener::open(const Address& address) {
  ErrorOf error;
  const Tcp::endpoint endpoint(asio::ip::make_address(address.host, error), address.port);
  if (!error) acceptor_.open(endpoint.protocol(), error);
  if (!error) acceptor_.set_option(asio::socket_base::reuse_address(true), error);
  if (!error) narrow(acceptor_);
  if (!error) acceptor_.bind(endpoint, error);
  if (!error) acceptor_.listen(asio::socket_base::max_listen_connections, error);
  if (error) {
    return fail(ErrorCode::kUnreachable, "cannot listen on " + address.host + ":" + std::to_string(address.port) +
                                             ": " + error.message() +
                                             ": is another broker running? choose another address with --listen");
  }
  port_ = acceptor_.local_endpoint(error).port();
  accept();
  return {};
}

Result<void> Listener::adopt(int listening) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  ErrorOf error;
  const bool known = ::getsockname(listening, reinterpret_cast<sockaddr*>(&address), &length) == 0;
  if (known) acceptor_.assign(address.ss_family == AF_INET6 ? Tcp::v6() : Tcp::v4(), listening, error);
  if (known && !error) narrow(acceptor_);
  if (!known || error) {
    return fail(ErrorCode::kUnreachable, "the socket that was handed over cannot be used: " + error.message());
  }
  port_ = acceptor_.local_endpoint(error).port();
  accept();
  return {};
}

void Listener::close() {
  ErrorOf ignored;
  acceptor_.close(ignored);
  pause_.cancel();
}

void Listener::accept() {
  acceptor_.async_accept(loop_.get_executor(), [this](ErrorOf error, Socket socket) {
    if (!acceptor_.is_open()) return;
    if (!error) {
      accept();  // First, so that accepting continues even if the handler throws.
      socket.set_option(kReceiveOption, error);
      return on_connection_(std::move(socket));
    }
    if (error == asio::error::operation_aborted) return;
    if (error != asio::error::no_descriptors && error != asio::error::no_memory) return accept();
    // Out of descriptors: the connection stays in the backlog; retrying at once would spin.
    log(log_, LogLevel::kError,
        "cannot accept a connection: " + error.message() + ": raise the limit of open files (ulimit -n)");
    run_after(pause_, std::chrono::milliseconds(200), [this] { accept(); });
  });
}

}  // namespace eigencast::broker
