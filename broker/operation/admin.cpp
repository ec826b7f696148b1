// SPDX-License-Identifier: MIT
#include "broker/operation/admin.h"

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <ctime>
#include <memory>
#include <utility>

#include "broker/http/access_facts.h"
#include "broker/http/http_target.h"

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
  void answer() {
    const std::string target(parser_.get().target());
    const bool reads = parser_.get().method() == http::verb::get || parser_.get().method() == http::verb::head;
    response_.version(11);
    response_.keep_alive(false);
    response_.set(http::field::content_type, "text/plain; charset=utf-8");
    const bool health = target == "/livez" || target == "/readyz";
    const auto denied = health ? std::nullopt
                               : context_.gate.admit_admin(access_request_from(parser_.get(), peer_of(socket_), {}),
                                                           Gate::AdminAsk::kRead, steady_now_us(), std::time(nullptr));
    if (denied) {
      response_.result(static_cast<unsigned>(denied->status));
      if (denied->status == 401) response_.set(http::field::www_authenticate, "Bearer realm=\"eigencast\"");
      if (denied->retry_after_s > 0) response_.set(http::field::retry_after, std::to_string(denied->retry_after_s));
      response_.body() = denied->message + "\n";
    } else if (!reads) {
      response_.result(http::status::method_not_allowed);
      response_.set(http::field::allow, "GET, HEAD");
    } else if (target == "/livez") {
      response_.body() = "alive\n";
    } else if (target == "/readyz") {
      if (context_.draining) response_.result(http::status::service_unavailable);
      response_.body() = context_.draining ? "stopping\n" : "ready\n";
    } else if (target == "/version") {
      response_.body() = "eigencast-broker " + context_.version + "\n";
    } else if (target == "/metrics") {
      response_.set(http::field::content_type, "text/plain; version=0.0.4; charset=utf-8");
      response_.body() = metrics_text(context_);
    } else {
      response_.result(http::status::not_found);
      response_.body() = "see /livez /readyz /version /metrics\n";
    }
    response_.prepare_payload();
    if (parser_.get().method() == http::verb::head) response_.body().clear();
    http::async_write(socket_, response_, [self = shared_from_this()](ErrorOf, std::size_t) {
      ErrorOf ignored;
      self->socket_.shutdown(Tcp::socket::shutdown_both, ignored);
      self->timer_.cancel();
    });
  }

  Context& context_;
  Socket socket_;
  Timer timer_;
  beast::flat_buffer buffer_;
  http::request_parser<http::empty_body> parser_;
  http::response<http::string_body> response_;
};

void metric(std::string& out, std::string_view name, std::string_view type, std::string_view help,
            std::uint64_t value) {
  const std::string full = "eigencast_broker_" + std::string(name);
  out += "# HELP " + full + " " + std::string(help) + "\n# TYPE " + full + " " + std::string(type) + "\n";
  out += full + " " + std::to_string(value) + "\n";
}

}  // namespace

void serve_admin(Context& context, Socket socket) {
  std::make_shared<AdminSession>(context, std::move(socket))->start();
}

std::string metrics_text(const Context& context) {
  const Counters& counters = context.counters;
  std::uint64_t live = 0;
  std::uint64_t watchers = 0;
  std::uint64_t failed = 0;
  for (const Stream* stream : context.hub.streams()) {
    live += stream->state() == control::StreamInfo::State::kLive ? 1 : 0;
    watchers += stream->watchers();
    failed += stream->poses_failed();
  }
  std::string out;
  metric(out, "connections", "gauge", "Open connections of the data port.", counters.connections);
  metric(out, "connections_total", "counter", "Connections accepted on the data port.", counters.connections_total);
  metric(out, "connections_refused_total", "counter", "Connections over limits.max_connections.",
         counters.connections_refused);
  metric(out, "streams", "gauge", "Streams known.", context.hub.size());
  metric(out, "streams_live", "gauge", "Streams with a sender.", live);
  metric(out, "subscriptions", "gauge", "Streams watched, summed over connections.", watchers);
  metric(out, "frames_received_total", "counter", "Frames taken from senders.", counters.frames_received);
  metric(out, "frames_refused_total", "counter", "Frames of senders that broke the protocol.", counters.frames_refused);
  metric(out, "frames_sent_total", "counter", "Frames sent to viewers.", counters.frames_sent);
  metric(out, "frame_bytes_sent_total", "counter", "Bytes of those frames.", counters.frame_bytes_sent);
  metric(out, "frames_skipped_total", "counter", "Frames replaced by newer ones before they left.",
         counters.frames_skipped);
  metric(out, "poses_failed", "gauge", "Poses beyond the codec's range, summed over the streams known.", failed);
  metric(out, "joins_sent_total", "counter", "Join frames sent.", counters.joins_sent);
  metric(out, "control_received_total", "counter", "Control messages received.", counters.control_received);
  metric(out, "control_sent_total", "counter", "Control messages sent.", counters.control_sent);
  metric(out, "slow_disconnects_total", "counter", "Connections closed because control messages piled up.",
         counters.slow_disconnects);
  metric(out, "uploads_total", "counter", "Assets taken.", counters.uploads);
  metric(out, "uploads_failed_total", "counter", "Uploads refused or cut off.", counters.uploads_failed);
  metric(out, "downloads_total", "counter", "Assets served, whole or in part.", counters.downloads);
  metric(out, "asset_bytes", "gauge", "Bytes in the asset store.", context.assets.total_bytes());
  return out;
}

}  // namespace eigencast::broker
