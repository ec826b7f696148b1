// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/async_result.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/websocket/teardown.hpp>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/net/url.h"

namespace eigencast {

/// Whom a client trusts. Null: the URL asks for no TLS. TLS 1.2 or newer; certificates are verified, against the system's
/// authorities or those of the URL's ca_file, unless it says `insecure`.
/// Errors: kInvalidArgument (no certificate or key in a file that the URL names; a key of another certificate).
using ClientTls = std::shared_ptr<boost::asio::ssl::context>;
Result<ClientTls> make_client_tls(const BrokerUrl& url);

/// The bytes of a client's connection, plain or TLS, as Beast wants them. One thread at a time: its handlers run on the
/// executor.
class ClientStream {
 public:
  using next_layer_type = boost::beast::tcp_stream;
  using executor_type = next_layer_type::executor_type;
  using error_code = boost::system::error_code;

  ClientStream(const executor_type& executor, ClientTls tls) : tcp_(executor), context_(std::move(tls)) {
    if (context_) tls_.emplace(tcp_, *context_);
  }
  executor_type get_executor() { return tcp_.get_executor(); }
  next_layer_type& next_layer() { return tcp_; }
  const next_layer_type& next_layer() const { return tcp_; }

  /// The TLS handshake with the URL's host, whose name or address the certificate must bear; plain: nothing to do.
  template <typename Handler>
  void async_secure(const BrokerUrl& url, Handler handler) {
    if (!tls_) return boost::asio::post(get_executor(), [handler = std::move(handler)]() mutable { handler({}); });
    expect(url);
    tls_->async_handshake(boost::asio::ssl::stream_base::client, std::move(handler));
  }
  /// Why the handshake with `url` failed, and what to do. kRefused: the broker's certificate does not do, which only
  /// people can change; else kUnreachable.
  Error handshake_failure(const BrokerUrl& url, const error_code& code) const;
  /// What to do where `code` ended a connection; empty: nothing particular.
  static std::string advice_on(const error_code& code);

  template <typename Buffers, typename Handler>
  auto async_read_some(const Buffers& buffers, Handler&& handler) {
    return boost::asio::async_initiate<Handler, void(error_code, std::size_t)>(
        [this](auto&& done, const Buffers& into) {
          if (tls_) return tls_->async_read_some(into, std::forward<decltype(done)>(done));
          tcp_.async_read_some(into, std::forward<decltype(done)>(done));
        },
        handler, buffers);
  }
  template <typename Buffers, typename Handler>
  auto async_write_some(const Buffers& buffers, Handler&& handler) {
    return boost::asio::async_initiate<Handler, void(error_code, std::size_t)>(
        [this](auto&& done, const Buffers& from) {
          if (tls_) return tls_->async_write_some(from, std::forward<decltype(done)>(done));
          tcp_.async_write_some(from, std::forward<decltype(done)>(done));
        },
        handler, buffers);
  }

  template <typename Handler>
  friend void async_teardown(boost::beast::role_type role, ClientStream& stream, Handler&& handler) {
    if (stream.tls_) return stream.tls_->async_shutdown(std::forward<Handler>(handler));
    boost::beast::websocket::async_teardown(role, stream.tcp_.socket(), std::forward<Handler>(handler));
  }

 private:
  void expect(const BrokerUrl& url);

  boost::beast::tcp_stream tcp_;
  ClientTls context_;
  std::optional<boost::asio::ssl::stream<boost::beast::tcp_stream&>> tls_;
  std::string distrust_;  ///< What is wrong with the certificate; empty: nothing.
};

}  // namespace eigencast
