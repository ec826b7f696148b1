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
#include "broker/http/access_request.h"
#include "broker/http/http_connection.h"
#include "broker/http/http_target.h"
#include "broker/loops/loops.h"
#include "broker/operation/metrics.h"
#include "broker/operation/report.h"
#include "broker/storage/recorder.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr std::int64_t kTimeoutMs = 5'000;
constexpr std::uint64_t kMaxBodyBytes = 64 * 1024;  ///< Ignored: parameters are in the query.

/// One request, one answer.
class AdminSession final : public HttpConnection {
 public:
  AdminSession(Context& context, Socket socket) : HttpConnection(context, Transport(std::move(socket))) {}

 private:
  Limits limits() const override { return {kTimeoutMs, kTimeoutMs, kMaxBodyBytes, "64 KiB", false}; }

  void decorate(HttpHeaders& headers) const override {
    headers.emplace_back("Cache-Control", "no-store");
    headers.emplace_back("X-Content-Type-Options", "nosniff");
  }

  void on_head() override {
    const std::string_view whole = target();
    const auto question = std::min(whole.find('?'), whole.size());
    path_ = whole.substr(0, question);
    query_ = whole.substr(std::min(question + 1, whole.size()));
    if (admitted()) route();
  }

  /// Calls `answer` when each loop has done `work`.
  void ask_loops(std::function<void(Context&)> work, std::function<void()> answer) {
    context().loops.for_each_loop(std::move(work),
                                  [self = shared_from_this(), answer = std::move(answer)] { answer(); });
  }
  void ask_statistics(bool with_clients, std::function<void(const Statistics&)> answer) {
    const auto statistics = std::make_shared<Statistics>();
    ask_loops(
        [statistics, with_clients](Context& loop) {
          statistics->add(loop);
          if (with_clients) statistics->add_clients(loop);
        },
        [statistics, answer = std::move(answer)] { answer(*statistics); });
  }

  bool admitted() {
    if (path_ == "/livez" || path_ == "/readyz") return true;
    const auto ask = reads() ? Gate::AdminRequest::kRead : Gate::AdminRequest::kControl;
    auto denied = context().gate.admit_admin(access_request_from(*this, {}), ask, steady_now_us(), std::time(nullptr));
    // A page of another site must not control the broker through an administrator's browser.
    if (!denied && !reads() && !header("Origin").empty() && !same_origin()) {
      denied = Denial{403, "the admin API takes no orders from pages of another origin", 0, false};
    }
    if (denied) answer_denial(*denied);
    return !denied;
  }

  bool same_origin() const {
    const std::string origin = header("Origin");
    const auto host = origin.find("://");
    return host != std::string::npos && origin.substr(host + 3) == header("Host");
  }

  void answer_text(HttpStatus status, const std::string& text) {
    answer(status, text + "\n", {{"Content-Type", "text/plain; charset=utf-8"}});
  }
  void answer_result(const Result<void>& result) {
    if (result) return answer(HttpStatus::kOk, "{}\n");
    const ErrorCode code = result.error().code;
    answer_error(code == ErrorCode::kNotFound          ? HttpStatus::kNotFound
                 : code == ErrorCode::kInvalidArgument ? HttpStatus::kBadRequest
                                                       : HttpStatus::kConflict,
                 result.error());
  }

  void route() {
    if (reads()) return route_read();
    if (method() == HttpMethod::kPost) return route_order();
    answer_error(HttpStatus::kMethodNotAllowed,
                 fail(ErrorCode::kUnsupported, "the admin port takes GET, HEAD and POST"),
                 {{"Allow", "GET, HEAD, POST"}});
  }

  void route_read() {
    if (path_ == "/livez") {  // The answer passes through every loop.
      return ask_loops([](Context&) {}, [this] { answer_text(HttpStatus::kOk, "alive"); });
    }
    if (path_ == "/readyz") {
      if (context().draining) return answer_text(HttpStatus::kServiceUnavailable, "stopping");
      // Ready without a backbone too: the broker still serves its own streams.
      const bool alone = context().backbone != nullptr && !context().backbone->totals().connected;
      return answer_text(HttpStatus::kOk, alone ? "ready, degraded: " + context().backbone->status() : "ready");
    }
    if (path_ == "/version") return answer_text(HttpStatus::kOk, "eigencast-broker " + context().version);
    if (path_ == "/metrics") {
      return ask_statistics(false, [this](const Statistics& statistics) {
        answer(HttpStatus::kOk, metrics_text(context(), statistics),
               {{"Content-Type", "text/plain; version=0.0.4; charset=utf-8"}});
      });
    }
    if (path_ == "/") return answer_page();
    if (path_ == "/api/broker") {
      return ask_statistics(false, [this](const Statistics& statistics) {
        answer(HttpStatus::kOk, broker_report(context(), statistics));
      });
    }
    if (path_ == "/api/streams") {
      return ask_statistics(false, [this](const Statistics& statistics) {
        answer(HttpStatus::kOk, streams_report(context(), statistics));
      });
    }
    if (path_ == "/api/clients") {
      return ask_statistics(
          true, [this](const Statistics& statistics) { answer(HttpStatus::kOk, clients_report(statistics)); });
    }
    if (path_ == "/api/recordings") return answer(HttpStatus::kOk, recordings_report(context()));
    answer_error(HttpStatus::kNotFound,
                 fail(ErrorCode::kNotFound,
                      "see / /livez /readyz /version /metrics /api/broker /api/streams /api/clients /api/recordings"));
  }

  void answer_page() {
    const std::string nonce = random_id(32);
    answer(HttpStatus::kOk, status_page(nonce),
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
      return answer_result({});
    }
    if (path_ == "/api/clients/kick") return kick();
    const std::string stream = parameter("stream");
    if (path_ == "/api/recordings/start" || path_ == "/api/recordings/stop") {
      if (auto name = check_stream_name(stream); !name) {
        return answer_result(fail(ErrorCode::kInvalidArgument, "?stream=NAME: " + name.error().message));
      }
      return answer_result(path_ == "/api/recordings/start" ? context().recorder.start(stream)
                                                            : context().recorder.stop(stream));
    }
    answer_error(HttpStatus::kNotFound, fail(ErrorCode::kNotFound,
                                             "see POST /api/drain /api/clients/kick?id=N "
                                             "/api/recordings/start?stream=NAME /api/recordings/stop?stream=NAME"));
  }

  void kick() {
    const std::string id = parameter("id");
    const auto found = std::make_shared<bool>(false);
    ask_loops([id, found](Context& loop) { *found = *found || kick_in(loop, id); },
              [this, id, found] {
                answer_result(
                    *found ? Result<void>()
                           : fail(ErrorCode::kNotFound, "?id=N: there is no client '" + id + "', see /api/clients"));
              });
  }

  static bool kick_in(Context& loop, const std::string& id) {
    for (Connection* connection : loop.connections) {
      if (std::to_string(connection->id()) != id || connection->is_closing()) continue;
      log(loop.log, LogLevel::kWarning, connection->name() + ": closed through the admin port");
      ++loop.counters.kicked;
      connection->send_bye("closed by the operator", 0, websocket::CloseCode::kPolicy);
      return true;
    }
    return false;
  }

  /// A parameter of the query. Stream names and numbers need no decoding except of '/'.
  std::string parameter(const std::string& name) const {
    for (const std::string_view part : split(query_, '&')) {
      if (!part.starts_with(name + "=")) continue;
      std::string value(part.substr(name.size() + 1));
      for (auto slash = value.find("%2F"); slash != std::string::npos; slash = value.find("%2F")) {
        value.replace(slash, 3, "/");
      }
      return value;
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
