// SPDX-License-Identifier: MIT
#include "broker/operation/admin.h"

#include <algorithm>
#include <ctime>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "broker/backbone/backbone.h"
#include "broker/connections/connection.h"
#include "broker/http/access_facts.h"
#include "broker/http/http_connection.h"
#include "broker/http/http_target.h"
#include "broker/loops.h"
#include "broker/operation/metrics.h"
#include "broker/operation/report.h"
#include "broker/random_id.h"

namespace eigencast::broker {
namespace {

namespace http = beast::http;

constexpr std::int64_t kPatienceMs = 5'000;
/// Of a body that nobody reads: orders stand in the query.
constexpr std::uint64_t kMostBodyBytes = 64 * 1024;

/// One request, one answer.
class AdminSession final : public HttpConnection {
 public:
  AdminSession(Context& context, Socket socket) : HttpConnection(context, Transport(std::move(socket))) {}

 private:
  Limits limits() const override { return {kPatienceMs, kPatienceMs, kMostBodyBytes, "64 KiB", false}; }

  void decorate(HttpHeaders& headers) const override {
    headers.emplace_back("Cache-Control", "no-store");
    headers.emplace_back("X-Content-Type-Options", "nosniff");
  }

  void on_head() override {
    const std::string target(parser().get().target());
    const auto question = target.find('?');
    path_ = target.substr(0, question);
    query_ = question == std::string::npos ? std::string() : target.substr(question + 1);
    if (admitted()) route();
  }

  /// Answers when each loop has done `work`.
  void ask_loops(std::function<void(Context&)> work, std::function<void()> answer) {
    context().loops.go_round(std::move(work), [self = shared_from_this(), answer = std::move(answer)] { answer(); });
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

  bool admitted() {
    if (path_ == "/livez" || path_ == "/readyz") return true;
    const auto ask = reads() ? Gate::AdminAsk::kRead : Gate::AdminAsk::kControl;
    auto denied = context().gate.admit_admin(access_request_from(parser().get(), peer(), {}), ask, steady_now_us(),
                                             std::time(nullptr));
    // A page of another site must not control the broker through the browser of whoever may.
    if (!denied && !reads() && parser().get().count(http::field::origin) > 0 && !same_origin()) {
      denied = Denial{403, "the admin API takes no orders from pages of another origin", 0, false};
    }
    if (denied) answer_denial(*denied);
    return !denied;
  }

  bool same_origin() const {
    const std::string origin = header(http::field::origin);
    const auto host = origin.find("://");
    return host != std::string::npos && origin.substr(host + 3) == header(http::field::host);
  }

  void say(Status status, const std::string& text) {
    answer(status, text + "\n", {{"Content-Type", "text/plain; charset=utf-8"}});
  }
  void say_result(const Result<void>& result) {
    if (result) return answer(Status::ok, "{}\n");
    const ErrorCode code = result.error().code;
    answer_error(code == ErrorCode::kNotFound          ? Status::not_found
                 : code == ErrorCode::kInvalidArgument ? Status::bad_request
                                                       : Status::conflict,
                 result.error());
  }

  void route() {
    if (reads()) return route_read();
    if (parser().get().method() == http::verb::post) return route_order();
    answer_error(Status::method_not_allowed, fail(ErrorCode::kUnsupported, "the admin port takes GET, HEAD and POST"),
                 {{"Allow", "GET, HEAD, POST"}});
  }

  void route_read() {
    if (path_ == "/livez") {  // All loops turn, or nobody answers.
      return ask_loops([](Context&) {}, [this] { say(Status::ok, "alive"); });
    }
    if (path_ == "/readyz") {
      if (context().draining) return say(Status::service_unavailable, "stopping");
      // A broker that has lost the others still serves its own streams: to take it out would end those too.
      const bool alone = context().backbone != nullptr && !context().backbone->totals().connected;
      return say(Status::ok, alone ? "ready, degraded: " + context().backbone->status() : "ready");
    }
    if (path_ == "/version") return say(Status::ok, "eigencast-broker " + context().version);
    if (path_ == "/metrics") {
      return ask_facts(false, [this](const Facts& facts) {
        answer(Status::ok, metrics_text(context(), facts),
               {{"Content-Type", "text/plain; version=0.0.4; charset=utf-8"}});
      });
    }
    if (path_ == "/") return say_page();
    if (path_ == "/api/broker") {
      return ask_facts(false, [this](const Facts& facts) { answer(Status::ok, broker_report(context(), facts)); });
    }
    if (path_ == "/api/streams") {
      return ask_facts(false, [this](const Facts& facts) { answer(Status::ok, streams_report(context(), facts)); });
    }
    if (path_ == "/api/clients") {
      return ask_facts(true, [this](const Facts& facts) { answer(Status::ok, clients_report(facts)); });
    }
    if (path_ == "/api/recordings") return answer(Status::ok, recordings_report(context()));
    answer_error(Status::not_found,
                 fail(ErrorCode::kNotFound,
                      "see / /livez /readyz /version /metrics /api/broker /api/streams /api/clients /api/recordings"));
  }

  void say_page() {
    const std::string nonce = random_id(32);
    answer(Status::ok, status_page(nonce),
           {{"Content-Type", "text/html; charset=utf-8"},
            {"Content-Security-Policy",
             "default-src 'none'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
             "frame-ancestors 'none'; script-src 'nonce-" +
                 nonce + "'; style-src 'nonce-" + nonce + "'"}});
  }

  void route_order() {
    if (path_ == "/api/drain") {
      log(context().log, LogLevel::kInfo, "told through the admin port to drain");
      context().drain();
      return say_result({});
    }
    if (path_ == "/api/clients/kick") return kick();
    const std::string stream = parameter("stream");
    if (path_ == "/api/recordings/start" || path_ == "/api/recordings/stop") {
      if (auto name = check_stream_name(stream); !name) {
        return say_result(fail(ErrorCode::kInvalidArgument, "?stream=NAME: " + name.error().message));
      }
      return say_result(path_ == "/api/recordings/start" ? context().recorder.start(stream)
                                                         : context().recorder.stop(stream));
    }
    answer_error(Status::not_found, fail(ErrorCode::kNotFound,
                                         "see POST /api/drain /api/clients/kick?id=N "
                                         "/api/recordings/start?stream=NAME /api/recordings/stop?stream=NAME"));
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

  std::string path_;
  std::string query_;
};

}  // namespace

void serve_admin(Context& context, Socket socket) {
  std::make_shared<AdminSession>(context, std::move(socket))->start();
}

}  // namespace eigencast::broker
