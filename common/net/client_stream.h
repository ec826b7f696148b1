// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/associated_executor.hpp>
#include <boost/asio/buffer.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/beast/core/role.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/container/static_vector.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/net/url.h"

namespace eigencast {

/// The authorities and certificates of a client. Null: the URL asks for no TLS. TLS 1.2 or newer; certificates are
/// verified, against the system's authorities or those of the URL's ca_file, unless it says `insecure`.
/// Errors: kInvalidArgument (no certificate or key in a file that the URL names; a key of another certificate).
using ClientTls = std::shared_ptr<boost::asio::ssl::context>;
Result<ClientTls> make_client_tls(const BrokerUrl& url);

/// Any handler of an asynchronous operation, on the executor that it asks for: what takes one is compiled once, not
/// once for each kind of handler. To be called once.
template <typename... Results>
class AnyHandler {
 public:
  using executor_type = boost::asio::any_io_executor;

  template <typename Handler>
  AnyHandler(Handler handler, const executor_type& otherwise)
      : executor_(boost::asio::get_associated_executor(handler, otherwise)),
        call_(std::make_unique<Of<Handler>>(std::move(handler))) {}
  executor_type get_executor() const noexcept { return executor_; }
  void operator()(Results... results) { call_->run(results...); }

 private:
  struct Call {
    virtual ~Call() = default;
    virtual void run(Results... results) = 0;
  };
  template <typename Handler>
  struct Of final : Call {
    explicit Of(Handler&& given) : handler(std::move(given)) {}
    void run(Results... results) override { handler(results...); }
    Handler handler;
  };
  executor_type executor_;
  std::unique_ptr<Call> call_;
};

/// A client's connection, plain or TLS, as Beast wants it. One thread at a time: its handlers run on the executor.
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
  void async_secure(const BrokerUrl& url, std::function<void(error_code)> handler);
  /// Why the handshake with `url` failed, and what to do. kRefused: the broker's certificate does not do, which only
  /// people can change; else kUnreachable.
  Error handshake_failure(const BrokerUrl& url, const error_code& code) const;
  /// Whether the peer wants a certificate that it was not given: only people can change that.
  static bool wants_certificate(const boost::system::error_code& code);
  /// What to do where `code` ended a connection before an answer; empty: nothing particular.
  ///   origin  the broker's, BrokerUrl::origin()
  static std::string advice_on(const error_code& code, std::string_view origin);

  // What Beast asks of a stream.
  template <typename Buffers, typename Handler>
  void async_read_some(const Buffers& buffers, Handler&& handler) {
    read_some(first_of<boost::asio::mutable_buffer>(buffers), {std::forward<Handler>(handler), get_executor()});
  }
  template <typename Buffers, typename Handler>
  void async_write_some(const Buffers& buffers, Handler&& handler) {
    write_some(first_of<boost::asio::const_buffer>(buffers), {std::forward<Handler>(handler), get_executor()});
  }
  template <typename Handler>
  friend void async_teardown(boost::beast::role_type role, ClientStream& stream, Handler&& handler) {
    stream.tear_down(role, {std::forward<Handler>(handler), stream.get_executor()});
  }

 private:
  using Moved = AnyHandler<error_code, std::size_t>;
  template <typename Buffer>
  using Pieces = boost::container::static_vector<Buffer, 16>;

  /// Takes as many as go into one call; the caller comes back for the rest.
  template <typename Buffer, typename Buffers>
  static Pieces<Buffer> first_of(const Buffers& buffers) {
    Pieces<Buffer> pieces;
    const auto end = boost::asio::buffer_sequence_end(buffers);
    for (auto it = boost::asio::buffer_sequence_begin(buffers); it != end && pieces.size() < pieces.capacity(); ++it) {
      if (const Buffer piece = *it; piece.size() > 0) pieces.push_back(piece);
    }
    return pieces;
  }
  void read_some(const Pieces<boost::asio::mutable_buffer>& into, Moved handler);
  void write_some(const Pieces<boost::asio::const_buffer>& from, Moved handler);
  void tear_down(boost::beast::role_type role, AnyHandler<error_code> handler);
  void expect(const BrokerUrl& url);

  boost::beast::tcp_stream tcp_;
  ClientTls context_;
  std::optional<boost::asio::ssl::stream<boost::beast::tcp_stream&>> tls_;
  std::string distrust_;  ///< What is wrong with the certificate; empty: nothing.
};

}  // namespace eigencast
