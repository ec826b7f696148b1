// SPDX-License-Identifier: MIT
#include "broker/operation/admin.h"

#include <algorithm>
#include <charconv>
#include <ctime>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "broker/backbone/backbone.h"
#include "broker/connections/connection.h"
#include "broker/http/http_connection.h"
#include "broker/http/http_session.h"
#include "broker/loops/loops.h"
#include "broker/operation/metrics.h"
#include "broker/relay/hub.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/recorder.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

using nlohmann::json;

constexpr std::int64_t kTimeoutMs = 5'000;
constexpr std::int64_t kMaxConnections = 64;
constexpr std::size_t kMaxListedClients = 50, kMaxListedStreams = 100;
constexpr std::uint64_t kMaxBodyBytes = 64 * 1024;  ///< Ignored: parameters are in the query.

double seconds(TimeUs us) {
  return static_cast<double>(us) * 1e-6;
}

std::optional<std::uint64_t> id_from(std::string_view text) {
  std::uint64_t id = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), id);
  return error == std::errc() && end == text.data() + text.size() ? std::optional(id) : std::nullopt;
}

std::string json_text(const json& value) {
  return value.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
}

/// Its streams by hand, as page_of_streams() does: there may be many.
void append_json(const ClientInfo& client, std::string& out) {
  const json rest = {
      {"id", client.id},
      {"kind", client.kind == ClientInfo::Kind::kSender ? "sender" : "viewer"},
      {"who", client.who},
      {"connected_s", seconds(client.connected_us)},
      {"stream_count", client.stream_count},
      {"round_trip_ms", client.round_trip_us ? json(static_cast<double>(*client.round_trip_us) * 1e-3) : json()},
      {"acknowledges", client.acknowledges},
      {"frames_sent", client.frames_sent},
      {"bytes_sent", client.bytes_sent},
      {"frames_dropped", client.dropped},
      {"joins_sent", client.joins},
      {"control_waiting", client.control_waiting}};
  out += rest.dump(-1, ' ', false, json::error_handler_t::replace);
  out.back() = ',';
  out += R"("streams":[)";
  for (const auto& watched : client.streams) {
    out.append(R"({"stream":")").append(watched.stream).append(R"(","profile":")").append(watched.profile);
    out.append(R"(","rung":)").append(std::to_string(watched.rung)).append("},");
  }
  if (out.back() == ',') out.pop_back();
  out += "]}";
}

/// The first streams after a name, and what each loop makes of them.
struct StreamPage {
  struct Made {
    std::uint64_t frames = 0, poses_failed = 0, profiles = 0;
  };

  std::string after{};
  std::map<std::string, Made, std::less<>> made{};

  /// REQUIRES: the first loop is added first, which has all streams.
  void add(Context& loop) {
    if (std::exchange(is_first_, false)) {
      for (const Stream* stream : loop.hub.streams(after, kMaxListedStreams)) made.try_emplace(stream->name());
    }
    for (auto& [name, sum] : made) {
      const Stream* stream = loop.hub.find(name);
      if (stream == nullptr) continue;
      sum.frames += stream->frames_made();
      sum.poses_failed += stream->poses_failed();
      sum.profiles += stream->profile_count();
    }
  }

  std::string report(Context& first) const {
    json list = json::array();
    for (const auto& [name, sum] : made) {
      const Stream* stream = first.hub.find(name);
      if (stream == nullptr) continue;  // It has gone meanwhile.
      list.push_back({{"stream", name},
                      {"stream_id", stream->id()},
                      {"state", name_of(stream->state())},
                      {"epoch", stream->epoch()},
                      {"asset", stream->asset()},
                      {"codec", stream->announcement().format.codec},
                      {"rows", stream->announcement().format.rows},
                      {"key_rate_hz", stream->key_rate_hz()},
                      {"keys_received", stream->keys_received()},
                      {"frames_made", sum.frames},
                      {"poses_failed", sum.poses_failed},
                      {"profiles", sum.profiles},
                      {"viewers", stream->watchers()}});
    }
    json page = {{"streams", list}, {"total", first.hub.size()}};
    if (made.size() == kMaxListedStreams && !first.hub.streams(made.rbegin()->first, 1).empty())
      page["next"] = made.rbegin()->first;
    return json_text(page);
  }

 private:
  bool is_first_ = true;
};

/// The first clients with ids after `after`: each loop adds its own.
struct ClientPage {
  std::uint64_t after = 0;
  std::vector<ClientInfo> clients{};  ///< By id; one more than the page has, if more follow.
  std::size_t total = 0;

  void add(const Context& loop) {
    total += loop.connections.size();
    const auto added = static_cast<std::ptrdiff_t>(clients.size());
    auto next = loop.connections.upper_bound(after);
    for (std::size_t i = 0; i <= kMaxListedClients && next != loop.connections.end(); ++i, ++next) {
      next->second->describe(clients.emplace_back());
    }
    std::inplace_merge(clients.begin(), clients.begin() + added, clients.end(),
                       [](const auto& a, const auto& b) { return a.id < b.id; });
    clients.resize(std::min(clients.size(), kMaxListedClients + 1));
  }

  std::string report() const {
    const std::size_t listed = std::min(clients.size(), kMaxListedClients);
    std::string page = R"({"clients":[)";
    for (std::size_t i = 0; i < listed; ++i) {
      if (i > 0) page += ',';
      append_json(clients[i], page);
    }
    page.append(R"(],"total":)").append(std::to_string(total));
    if (clients.size() > listed) page.append(R"(,"next":)").append(std::to_string(clients[listed - 1].id));
    return page + "}\n";
  }
};

std::string recordings_report(const Context& context) {
  json list = json::array();
  for (const RecordingInfo& info : context.recorder.list()) {
    list.push_back({{"stream", info.stream},
                    {"state", kRecordingStates[info.state]},
                    {"file", info.file},
                    {"error", info.error},
                    {"bytes", info.bytes},
                    {"frames", info.frames},
                    {"frames_dropped", info.dropped},
                    {"duration_s", seconds(info.duration_us)}});
  }
  return json_text({{"recordings", list}});
}

/// What does not work although streams do. Empty: everything works.
std::string trouble_of(const Context& context) {
  std::string trouble =
      context.disk_fails ? "the data folder takes no files (see the log): uploads and recordings fail" : "";
  if (context.backbone != nullptr && !context.backbone->totals().connected)
    trouble += (trouble.empty() ? "" : "; ") + context.backbone->status();
  const auto open = static_cast<std::int64_t>(context.loops.connections_total());
  const std::int64_t most = context.gate.policy()->max_connections();
  if (open >= most - most / 16) {
    trouble += (trouble.empty() ? "" : "; ") + std::to_string(open) + " of " + std::to_string(most) +
               " connections are open (limits.max_connections, and descriptors: ulimit -n)";
  }
  return trouble;
}

std::string broker_report(const Context& context, const Statistics& statistics) {
  const Counters& counters = statistics.counters;
  return json_text({{"version", context.version},
                    {"session_id", context.session_id},
                    {"uptime_s", seconds(steady_now_us() - context.started_us)},
                    {"state", context.draining              ? "draining"
                              : trouble_of(context).empty() ? "ok"
                                                            : "degraded"},
                    {"backbone", context.backbone == nullptr ? json() : json(context.backbone->status())},
                    {"draining", context.draining},
                    {"threads", statistics.connections.size()},
                    {"connections", statistics.connections_total()},
                    {"frames_received", counters.frames_received},
                    {"frames_sent", counters.frames_sent},
                    {"frame_bytes_sent", counters.frame_bytes_sent},
                    {"frames_dropped", counters.frames_dropped},
                    {"asset_bytes", context.assets.total_bytes()},
                    {"recordings", context.recorder.totals().active}});
}

class AdminSession final : public HttpConnection {
 public:
  AdminSession(Context& context, Socket socket, std::shared_ptr<void> counted)
      : HttpConnection(context, Transport(std::move(socket))), counted_(std::move(counted)) {}

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
    if (!admitted()) return;
    if (reads()) return route_read();
    if (method() == "POST") return route_order();
    refuse_method("the admin port takes GET, HEAD and POST", "GET, HEAD, POST");
  }

  /// Calls `answer` when each loop has done `work`.
  void ask_loops(std::function<void(Context&)> work, std::function<void()> answer) {
    context().loops.for_each_loop(std::move(work),
                                  [self = shared_from_this(), answer = std::move(answer)] { answer(); });
  }
  using Report = std::string (*)(const Context&, const Statistics&);
  void answer_statistics(Report report, const HttpHeaders& headers = {}) {
    const auto statistics = std::make_shared<Statistics>();
    ask_loops(
        [statistics](Context& loop) { statistics->add(loop); },
        [this, statistics, report, headers] { answer(HttpStatus::kOk, report(context(), *statistics), headers); });
  }
  void answer_streams() {
    const auto page = std::make_shared<StreamPage>();
    page->after = parameter("after");
    ask_loops([page](Context& loop) { page->add(loop); },
              [this, page] { answer(HttpStatus::kOk, page->report(context())); });
  }
  void answer_clients() {
    const auto page = std::make_shared<ClientPage>();
    const std::string after = parameter("after");
    if (const auto id = id_from(after)) {
      page->after = *id;
    } else if (!after.empty()) {
      return answer_result(fail(ErrorCode::kInvalidArgument,
                                "?after=ID: '" + after + "' is no id: take 'next' of the page before, or none"));
    }
    ask_loops([page](Context& loop) { page->add(loop); }, [this, page] { answer(HttpStatus::kOk, page->report()); });
  }

  bool admitted() {
    if (path_ == "/livez" || path_ == "/readyz") return true;
    const auto ask = reads() ? Gate::AdminRequest::kRead : Gate::AdminRequest::kControl;
    auto denied = context().gate.admit_admin(access_request({}), ask, steady_now_us(), std::time(nullptr));
    // A page of another site must not control the broker through an administrator's browser.
    if (!denied && !reads() && !header("Origin").empty() && !same_origin()) {
      denied = Denial{403, "the admin API takes no orders from pages of another origin"};
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

  void route_read() {
    if (path_ == "/livez") {  // The answer passes through every loop.
      return ask_loops([](Context&) {}, [this] { answer_text(HttpStatus::kOk, "alive"); });
    }
    if (path_ == "/readyz") {
      if (context().draining) return answer_text(HttpStatus::kServiceUnavailable, "stopping");
      // Ready without a backbone or a disk too: the broker still serves its own streams.
      const std::string trouble = trouble_of(context());
      return answer_text(HttpStatus::kOk, trouble.empty() ? "ready" : "ready, degraded: " + trouble);
    }
    if (path_ == "/version") return answer_text(HttpStatus::kOk, "eigencast-broker " + context().version);
    if (path_ == "/metrics") {
      return answer_statistics(metrics_text, {{"Content-Type", "text/plain; version=0.0.4; charset=utf-8"}});
    }
    if (path_ == "/") return answer_page();
    if (path_ == "/api/broker") return answer_statistics(broker_report);
    if (path_ == "/api/streams") return answer_streams();
    if (path_ == "/api/clients") return answer_clients();
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
      log(context().log, LogLevel::kInfo, "draining, as the admin port asked");
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
    const std::string text = parameter("id");
    const auto id = id_from(text);
    const auto result = std::make_shared<Result<void>>(
        fail(ErrorCode::kNotFound, "?id=N: there is no client '" + text + "', see /api/clients"));
    ask_loops(
        [id, result](Context& loop) {
          const auto found = id ? loop.connections.find(*id) : loop.connections.end();
          if (found == loop.connections.end() || found->second->is_closing()) return;
          *result = {};
          log(loop.log, LogLevel::kWarning, found->second->name() + ": closed through the admin port");
          ++loop.counters.kicked;
          found->second->send_bye("closed by the operator", 0, websocket::CloseCode::kPolicy);
        },
        [this, result] { answer_result(*result); });
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
  std::shared_ptr<void> counted_;
};

}  // namespace

void serve_admin(Context& context, Socket socket, Shares& open) {
  const std::string peer = peer_of(socket).site_key();
  if (!open.fits(peer, 1, kMaxConnections)) {
    return turn_away(context, Transport(std::move(socket)), {429, "too many connections of the admin port", 1});
  }
  std::make_shared<AdminSession>(context, std::move(socket), open.hold(peer, 1))->start();
}

}  // namespace eigencast::broker
