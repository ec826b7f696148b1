// SPDX-License-Identifier: MIT
#include "broker/operation/admin.h"

#include <algorithm>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <ctime>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "broker/backbone/backbone.h"
#include "broker/connections/connection.h"
#include "broker/http/access_facts.h"
#include "broker/http/http_target.h"
#include "broker/loops.h"
#include "broker/operation/metrics.h"
#include "broker/operation/report.h"
#include "broker/random_id.h"

namespace eigencast::broker {
namespace {

namespace http = beast::http;

/// Reads one request and answers it. Kept alive by its pending operation.
class AdminSession : public std::enable_shared_from_this<AdminSession> {
 public:
  AdminSession(Context& context, Socket socket)
      : context_(context), socket_(std::move(socket)), timer_(context.loop.get_executor()) {}

  void start() {
    timer_.expires_after(std::chrono::seconds(5));
    timer_.async_wait([self = weak_from_this()](ErrorOf error) {
      ErrorOf ignored;
      if (auto session = self.lock(); session && !error) session->socket_.close(ignored);
    });
    parser_.header_limit(8 * 1024);
    parser_.body_limit(0);
    http::async_read(socket_, buffer_, parser_, [self = shared_from_this()](ErrorOf error, std::size_t) {
      if (!error) self->answer();
    });
  }

 private:
  using Status = http::status;

  void answer() {
    response_.version(11);
    response_.keep_alive(false);
    response_.set(http::field::cache_control, "no-store");
    response_.set("X-Content-Type-Options", "nosniff");
    const std::string target(parser_.get().target());
    const auto question = target.find('?');
    path_ = target.substr(0, question);
    query_ = question == std::string::npos ? std::string() : target.substr(question + 1);
    if (admitted()) route();
    if (!asks_loops_) respond();
  }

  void respond() {
    response_.prepare_payload();
    if (parser_.get().method() == http::verb::head) response_.body().clear();
    http::async_write(socket_, response_, [self = shared_from_this()](ErrorOf, std::size_t) {
      ErrorOf ignored;
      self->socket_.shutdown(Tcp::socket::shutdown_both, ignored);
      self->timer_.cancel();
    });
  }

  /// Responds when each loop has done `work` and then `answer` was called.
  void ask_loops(std::function<void(Context&)> work, std::function<void()> answer) {
    asks_loops_ = true;
    context_.loops.go_round(std::move(work), [self = shared_from_this(), answer = std::move(answer)] {
      answer();
      self->respond();
    });
  }
  void ask_facts(bool with_clients, std::function<void(const Facts&)> answer) {
    const auto facts = std::make_shared<Facts>();
    ask_loops(
        [facts, with_clients](Context& loop) {
          facts->add(loop);
          if (with_clients) facts->add_clients(loop);
        },
        [facts, answer = std::move(answer)] { answer(*facts); });
  }

  bool reads() const { return parser_.get().method() == http::verb::get || parser_.get().method() == http::verb::head; }

  bool admitted() {
    if (path_ == "/livez" || path_ == "/readyz") return true;
    const auto ask = reads() ? Gate::AdminAsk::kRead : Gate::AdminAsk::kControl;
    auto denied = context_.gate.admit_admin(access_request_from(parser_.get(), peer_of(socket_), {}), ask,
                                            steady_now_us(), std::time(nullptr));
    // A page of another site must not control the broker through the browser of whoever may.
    if (!denied && !reads() && parser_.get().count(http::field::origin) > 0 && !same_origin()) {
      denied = Denial{403, "the admin API takes no orders from pages of another origin", 0, false};
    }
    if (!denied) return true;
    say(static_cast<Status>(denied->status), denied->message);
    if (denied->status == 401) response_.set(http::field::www_authenticate, "Bearer realm=\"eigencast\"");
    if (denied->retry_after_s > 0) response_.set(http::field::retry_after, std::to_string(denied->retry_after_s));
    return false;
  }

  bool same_origin() const {
    const std::string origin(parser_.get()[http::field::origin]);
    const auto host = origin.find("://");
    return host != std::string::npos && origin.substr(host + 3) == std::string(parser_.get()[http::field::host]);
  }

  void say(Status status, const std::string& text) {
    response_.result(status);
    response_.set(http::field::content_type, "text/plain; charset=utf-8");
    response_.body() = text + "\n";
  }
  void say_json(std::string text) {
    response_.set(http::field::content_type, "application/json");
    response_.body() = std::move(text);
  }
  void say_result(const Result<void>& result) {
    if (result) return say_json("{}\n");
    response_.result(result.error().code == ErrorCode::kNotFound ? Status::not_found : Status::conflict);
    say_json("{\"error\":" + json_quoted(name_of(result.error().code)) +
             ",\"message\":" + json_quoted(result.error().message) + "}\n");
  }

  void route() {
    if (reads()) return route_read();
    if (parser_.get().method() == http::verb::post) return route_order();
    say(Status::method_not_allowed, "the admin port takes GET, HEAD and POST");
    response_.set(http::field::allow, "GET, HEAD, POST");
  }

  void route_read() {
    if (path_ == "/livez") {  // All loops turn, or nobody answers.
      return ask_loops([](Context&) {}, [this] { say(Status::ok, "alive"); });
    }
    if (path_ == "/readyz") {
      if (context_.draining) return say(Status::service_unavailable, "stopping");
      // A broker that has lost the others still serves its own streams: to take it out would end those too.
      const bool alone = context_.backbone != nullptr && !context_.backbone->totals().connected;
      return say(Status::ok, alone ? "ready, degraded: " + context_.backbone->status() : "ready");
    }
    if (path_ == "/version") return say(Status::ok, "eigencast-broker " + context_.version);
    if (path_ == "/metrics") {
      response_.set(http::field::content_type, "text/plain; version=0.0.4; charset=utf-8");
      return ask_facts(false, [this](const Facts& facts) { response_.body() = metrics_text(context_, facts); });
    }
    if (path_ == "/") return say_page();
    if (path_ == "/api/broker") {
      return ask_facts(false, [this](const Facts& facts) { say_json(broker_report(context_, facts)); });
    }
    if (path_ == "/api/streams") {
      return ask_facts(false, [this](const Facts& facts) { say_json(streams_report(context_, facts)); });
    }
    if (path_ == "/api/clients") {
      return ask_facts(true, [this](const Facts& facts) { say_json(clients_report(facts)); });
    }
    if (path_ == "/api/recordings") return say_json(recordings_report(context_));
    say(Status::not_found,
        "see / /livez /readyz /version /metrics /api/broker /api/streams /api/clients /api/recordings");
  }

  void say_page() {
    const std::string nonce = random_id(32);
    response_.set(http::field::content_type, "text/html; charset=utf-8");
    response_.set("Content-Security-Policy",
                  "default-src 'none'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
                  "frame-ancestors 'none'; script-src 'nonce-" +
                      nonce + "'; style-src 'nonce-" + nonce + "'");
    response_.body() = status_page(nonce);
  }

  void route_order() {
    if (path_ == "/api/drain") {
      log(context_.log, LogLevel::kInfo, "told through the admin port to drain");
      context_.drain();
      return say_result({});
    }
    if (path_ == "/api/clients/kick") return kick();
    const std::string stream = parameter("stream");
    if (path_ == "/api/recordings/start" || path_ == "/api/recordings/stop") {
      if (auto name = check_stream_name(stream); !name) {
        return say_result(fail(ErrorCode::kInvalidArgument, "?stream=NAME: " + name.error().message));
      }
      return say_result(path_ == "/api/recordings/start" ? context_.recorder.start(stream)
                                                         : context_.recorder.stop(stream));
    }
    say(Status::not_found,
        "see POST /api/drain /api/clients/kick?id=N /api/recordings/start?stream=NAME "
        "/api/recordings/stop?stream=NAME");
  }

  void kick() {
    const std::string id = parameter("id");
    const auto found = std::make_shared<bool>(false);
    ask_loops(
        [id, found](Context& loop) { *found = *found || kick_in(loop, id); },
        [this, id, found] {
          say_result(*found ? Result<void>()
                            : fail(ErrorCode::kNotFound, "?id=N: there is no client '" + id + "', see /api/clients"));
        });
  }

  static bool kick_in(Context& loop, const std::string& id) {
    for (Connection* connection : loop.connections) {
      if (std::to_string(connection->id()) != id || connection->is_closing()) continue;
      log(loop.log, LogLevel::kWarning, connection->name() + ": closed through the admin port");
      ++loop.counters.kicked;
      connection->say_bye("closed by the operator", 0, websocket::CloseCode::kPolicy);
      return true;
    }
    return false;
  }

  /// Of the query; names of streams and numbers need no decoding but that of '/'.
  std::string parameter(const std::string& name) const {
    for (std::size_t at = 0; at < query_.size();) {
      const std::size_t end = std::min(query_.find('&', at), query_.size());
      if (query_.compare(at, name.size() + 1, name + "=") == 0) {
        std::string value = query_.substr(at + name.size() + 1, end - at - name.size() - 1);
        for (auto slash = value.find("%2F"); slash != std::string::npos; slash = value.find("%2F")) {
          value.replace(slash, 3, "/");
        }
        return value;
      }
      at = end + 1;
    }
    return {};
  }

  Context& context_;
  Socket socket_;
  Timer timer_;
  beast::flat_buffer buffer_;
  http::request_parser<http::empty_body> parser_;
  http::response<http::string_body> response_;
  std::string path_;
  std::string query_;
  bool asks_loops_ = false;
};

}  // namespace

void serve_admin(Context& context, Socket socket) {
  std::make_shared<AdminSession>(context, std::move(socket))->start();
}

}  // namespace eigencast::broker
