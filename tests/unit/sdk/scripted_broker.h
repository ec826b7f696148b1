// SPDX-License-Identifier: MIT
#pragma once

#include <sys/socket.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <functional>
#include <list>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/core/bytes.h"
#include "common/wire/control.h"

namespace eigencast {

/// Says what a real broker seldom does. It serves each connection on a thread of its own.
class ScriptedBroker {
 public:
  struct Script {
    std::vector<std::string> at_first;
    std::function<std::string(const std::string& stream)> to_subscribe = {};  ///< Its answer; empty: none.
    bool then_close = false;                                                  ///< After at_first.
    std::string refused_target = {};                                          ///< A path that is answered 403.
    std::vector<Bytes> frames = {};  ///< Follow each answer from that of number `streams` on.
    int streams = 0;
  };

  explicit ScriptedBroker(Script script)
      : script_(std::move(script)), acceptor_(loop_, Tcp::endpoint(boost::asio::ip::address_v4::loopback(), 0)) {
    acceptor_thread_ = std::thread([this] { accept(); });
  }
  /// REQUIRES: all clients are gone.
  ~ScriptedBroker() {
    ::shutdown(acceptor_.native_handle(), SHUT_RDWR);
    acceptor_thread_.join();
    for (std::thread& thread : threads_) thread.join();
  }

  std::string url(const std::string& stream = "live/ball") const {
    return "ws://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()) + "/" + stream;
  }
  /// Paths and queries of the upgrades so far, refused ones included.
  std::vector<std::string> targets() {
    const std::lock_guard lock(mutex_);
    return targets_;
  }
  /// The header Authorization of each.
  std::vector<std::string> tokens() {
    const std::lock_guard lock(mutex_);
    return tokens_;
  }
  /// The messages of one kind that came.
  template <typename Message>
  std::vector<Message> received() {
    const std::lock_guard lock(mutex_);
    std::vector<Message> all;
    for (const ControlMessage& message : messages_) {
      if (const auto* one = std::get_if<Message>(&message)) all.push_back(*one);
    }
    return all;
  }

 private:
  using Tcp = boost::asio::ip::tcp;
  using Link = boost::beast::websocket::stream<Tcp::socket, false>;
  using error_code = boost::system::error_code;

  void accept() {
    for (error_code ec;;) {
      Tcp::socket socket(loop_);
      acceptor_.accept(socket, ec);
      if (ec) return;
      threads_.emplace_back([this, s = std::move(socket)]() mutable { serve(std::move(s)); });
    }
  }

  void serve(Tcp::socket socket) {
    namespace http = boost::beast::http;
    error_code ec;
    boost::beast::flat_buffer in;
    http::request<http::string_body> request;
    http::read(socket, in, request, ec);
    const std::string target(request.target().data(), request.target().size());
    {
      const std::lock_guard lock(mutex_);
      targets_.push_back(target);
      tokens_.emplace_back(request[http::field::authorization].data(), request[http::field::authorization].size());
    }
    if (!script_.refused_target.empty() && target.starts_with(script_.refused_target)) {
      http::response<http::string_body> refusal(http::status::forbidden, 11);
      refusal.prepare_payload();
      http::write(socket, refusal, ec);
      return;
    }
    Link link(std::move(socket));
    link.set_option(boost::beast::websocket::stream_base::decorator(
        [](boost::beast::websocket::response_type& r) { r.set(http::field::sec_websocket_protocol, "eigencast.v2"); }));
    link.accept(request, ec);
    for (const std::string& text : script_.at_first) link.write(boost::asio::buffer(text), ec);
    if (script_.then_close) link.close(boost::beast::websocket::close_code::service_restart, ec);
    for (int subscribed = 0; !ec;) {
      in.clear();
      link.read(in, ec);
      const auto message = control_from_text(boost::beast::buffers_to_string(in.data()));
      if (ec || !message) continue;
      {
        const std::lock_guard lock(mutex_);
        messages_.push_back(*message);
      }
      const auto* request_of = std::get_if<control::Subscribe>(&*message);
      if (request_of == nullptr || !script_.to_subscribe) continue;
      const std::string answer = script_.to_subscribe(request_of->stream);
      if (!answer.empty()) link.write(boost::asio::buffer(answer), ec);
      if (++subscribed < script_.streams) continue;
      link.binary(true);
      for (const Bytes& frame : script_.frames) link.write(boost::asio::buffer(frame), ec);
      link.text(true);
    }
  }

  const Script script_;
  boost::asio::io_context loop_;
  Tcp::acceptor acceptor_;
  std::thread acceptor_thread_;
  std::list<std::thread> threads_;  ///< Belongs to the acceptor's thread, then to the destructor's.
  std::mutex mutex_;
  std::vector<std::string> targets_;      ///< GUARDED_BY(mutex_)
  std::vector<std::string> tokens_;       ///< GUARDED_BY(mutex_)
  std::vector<ControlMessage> messages_;  ///< GUARDED_BY(mutex_)
};

}  // namespace eigencast
