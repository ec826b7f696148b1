// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/basic_stream_socket.hpp>
#include <boost/asio/basic_waitable_timer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/system/error_code.hpp>
#include <chrono>
#include <utility>

/// Asio with concrete executors: any_io_executor costs a virtual call and an allocation per operation.
namespace eigencast::broker {

namespace asio = boost::asio;
using Tcp = asio::ip::tcp;
using Executor = asio::io_context::executor_type;
using Socket = asio::basic_stream_socket<Tcp, Executor>;
using Acceptor = asio::basic_socket_acceptor<Tcp, Executor>;
using Timer =
    asio::basic_waitable_timer<std::chrono::steady_clock, asio::wait_traits<std::chrono::steady_clock>, Executor>;
using ErrorOf = boost::system::error_code;

template <typename Work>
void run_after(Timer& timer, std::chrono::microseconds delay, Work work) {
  timer.expires_after(delay);
  timer.async_wait([work = std::move(work)](ErrorOf error) {
    if (!error) work();
  });
}

}  // namespace eigencast::broker
