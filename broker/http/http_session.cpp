// SPDX-License-Identifier: MIT
#include "broker/http/http_session.h"

#include <algorithm>
#include <ctime>
#include <utility>

#include "broker/connections/echo.h"
#include "broker/connections/publisher.h"
#include "broker/connections/subscriber.h"
#include "broker/http/asset_transfer.h"
#include "broker/http/http_connection.h"
#include "broker/http/http_target.h"
#include "broker/http/stream_list.h"
#include "broker/http/web_page.h"
#include "broker/loops/loops.h"
#include "broker/relay/hub.h"
#include "broker/websocket/protocol.h"
#include "common/core/text.h"
#include "common/wire/control.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxListed = 1000;
/// Names and patterns compared in about the time that an ordinary request takes.
constexpr double kNamesPerRequest = 100;
constexpr double kHeadBytesPerUs = 40;                 ///< Of '&' or ',' only, which cost most.
constexpr double kConnectionUs = 25, kRequestUs = 20;  ///< On one core of 2026.
constexpr double kUnpaidUs = 10'000;                   ///< A handshake, and a head in many reads.
constexpr TimeUs kMaxRequestWaitUs = 5'000'000;
constexpr int kMaxRequestWaitS = 5;
/// Refusals come so late that a client that asks at once again costs little.
constexpr TimeUs kRefusalWaitUs = 1'000'000;

/// The name that a page of the list follows.
Result<std::string> page_from_query(std::string_view query) {
  constexpr std::string_view kAfter = "after=";
  for (const std::string_view parameter : split(query, '&')) {
    if (!parameter.starts_with(kAfter)) continue;
    std::string name(parameter.substr(kAfter.size()));
    if (auto ok = check_stream_name(name); !ok) return ok.error();
    return name;
  }
  return std::string();
}

bool offers_subprotocol(std::string_view header) {
  const auto parts = split(header, ',');
  return std::any_of(parts.begin(), parts.end(), [](auto part) { return trimmed(part) == control::kSubprotocol; });
}

// Functions that return false have answered with a refusal.
class HttpSession final : public HttpConnection {
 public:
  HttpSession(Context& context, Transport transport, GrantPtr grant)
      : HttpConnection(context, std::move(transport)),
        counted_(counted_in(context.connection_count)),
        grant_(std::move(grant)),
        proxy_(context.gate.policy()->is_trusted_proxy(peer()) ? grant_ : nullptr) {
    ++context.counters.connections_total;
  }

 private:
  Limits limits() const override {
    const Config& config = context().config;
    return {config.timeouts.header_ms, config.timeouts.transfer_ms,
            static_cast<std::uint64_t>(config.assets.max_object_bytes), "assets.max_object_bytes"};
  }

  /// Whether a proxy has not said yet for whom it speaks: whom the head names pays.
  bool is_nobodys() const { return proxy_ && !is_head_read(); }
  Grant& payer() const { return is_nobodys() ? *proxy_ : *grant_; }

  std::optional<TimeUs> take_work(double us, TimeUs most_us) override {
    if (!is_nobodys() || unpaid_us_ + us > kUnpaidUs) return payer().take_http_work(us, steady_now_us(), most_us);
    unpaid_us_ += us;
    return 0;
  }

  std::string holder() const override { return payer().holder(); }
  bool take_turn(double us, TimeUs wait_us, std::function<void()> then, LoopShare::Hold hold) override {
    const bool is_paid_later = is_nobodys() && wait_us == 0;
    if (is_paid_later && (!hold || hold() == LoopShare::Supply::kHeld)) return true;
    return context().newcomers.take(holder(), is_paid_later ? 0 : us, wait_us, std::move(then), std::move(hold));
  }

  Result<std::shared_ptr<void>> hold_bytes(std::size_t bytes, double part) const override {
    return payer().hold_bytes(bytes, part);
  }
  std::shared_ptr<void> hold_wide(std::size_t bytes) const override {
    auto held = payer().hold_wide(bytes);
    return held ? std::move(*held) : nullptr;
  }
  TimeUs take_sending(double us) override {
    return payer().is_spared() ? 0 : *payer().take_http_work(us, steady_now_us(), kForeverUs);
  }

  void decorate(HttpHeaders& headers) const override {
    headers.emplace_back("X-Content-Type-Options", "nosniff");  // An asset must not be a script of the page's.
    if (std::any_of(headers.begin(), headers.end(), [](const auto& h) { return h.first == kAnyOrigin.first; })) return;
    headers.emplace_back("Vary", "Origin");  // Always: else caches give the answer without an origin to pages.
    const std::string origin = header("Origin");
    if (origin.empty() || !context().gate.policy()->allows_origin(access_request({}))) return;
    headers.emplace_back("Access-Control-Allow-Origin", origin);
    headers.emplace_back("Access-Control-Expose-Headers", "Accept-Ranges, Content-Range, ETag, Retry-After");
  }

  struct Task {
    std::function<void()> run;
    bool admitted = false;  ///< It counts towards grant_, else towards the client's address.
    double listing = 0;     ///< Names to compare, in ordinary requests.
  };

  /// Pays for the check of a token, and waits for its turn, before that is made: who sends one has shown nothing yet.
  void on_head() override {
    const auto parsed = target_from_text(target(), context().config.proxy.path_prefix);
    const AccessRequest request = access_request(parsed ? parsed->token : std::string());
    const double us = parsed ? context().gate.check_us(request, std::time(nullptr)) : 0;
    if (us == 0) return begin();
    const TimeUs now_us = steady_now_us();
    const auto payer = context().gate.stranger(request, now_us);
    const auto wait_us = payer->take_http_work(us, now_us, kMaxRequestWaitUs);
    if (!wait_us) {
      return later(kRefusalWaitUs,
                   [this] { answer_limit("tokens to check are over work_us_per_s", kMaxRequestWaitS); });
    }
    const auto in_turn = [self = shared_from_this(), this] {
      if (transport().socket().is_open()) begin();
    };
    if (context().newcomers.take(payer->holder(), us, *wait_us, in_turn)) return begin();
    disarm();
  }

  void begin() {
    Task task = admitted();
    const TimeUs now_us = steady_now_us();
    const double unpaid_us = std::exchange(unpaid_us_, 0);
    const auto per_s = static_cast<double>(context().config.limits.requests_per_s);
    const auto payer = task.admitted ? grant_ : context().gate.stranger(access_request({}), now_us);
    if (proxy_ && !task.admitted) {
      if (auto placed = take_place(*payer); !placed) task = refused({429, placed.error().message, 1});
      grant_ = payer;
    }
    const auto head = static_cast<double>(head_bytes());
    const TimeUs wait_us = *requests_.take(1 + task.listing, per_s, per_s, now_us, kForeverUs);
    const auto head_wait_us = payer->take_http_work(unpaid_us + (head > Grant::kFreeBytes ? head / kHeadBytesPerUs : 0),
                                                    now_us, kMaxRequestWaitUs);
    const auto holder_wait_us = payer->take_request(task.listing, now_us, kMaxRequestWaitUs);
    if (!head_wait_us || !holder_wait_us) {
      const std::string why = holder_wait_us ? "long requests are over work_us_per_s" : holder_wait_us.error().message;
      return later(std::max(wait_us, kRefusalWaitUs), [this, why] { answer_limit(why, kMaxRequestWaitS); });
    }
    const TimeUs delay_us = std::max({wait_us, *head_wait_us, *holder_wait_us});
    const double work_us =
        std::exchange(connection_us_, 0) + unpaid_us + kRequestUs * (1 + task.listing) + head / kHeadBytesPerUs;
    const auto in_turn = [self = shared_from_this(), this, task] {
      // By the rights of then: a token may end, a reload take them.
      if (transport().socket().is_open()) task.admitted ? admitted().run() : task.run();
    };
    if (context().newcomers.take(payer->holder(), work_us, delay_us, in_turn)) return task.run();
    disarm();
  }

  /// What the request asks for, or its refusal; admits the client.
  Task admitted() {
    auto parsed = target_from_text(target(), context().config.proxy.path_prefix);
    if (!parsed) {
      const bool missing = parsed.error().code == ErrorCode::kNotFound;
      return {[this, missing, error = parsed.error()] {
        answer_error(missing ? HttpStatus::kNotFound : HttpStatus::kBadRequest, error);
      }};
    }
    if (method() == "OPTIONS") return {[this] { answer_preflight(); }};
    if (parsed->kind == Target::Kind::kPage) return {[this, name = parsed->name] { serve_page(*this, name); }};
    if (parsed->kind == Target::Kind::kWebFile) return {[this, name = parsed->name] { serve_web_file(*this, name); }};
    auto admission = context().gate.admit(access_request(parsed->token), steady_now_us(), std::time(nullptr), true);
    if (const auto* denied = std::get_if<Denial>(&admission)) return refused(*denied);
    auto grant = std::get<GrantPtr>(std::move(admission));
    if (auto placed = take_place(*grant); !placed) return refused({429, placed.error().message, 1});
    grant_ = std::move(grant);
    Task task{[this, target = *parsed] { serve(target); }, true};
    if (parsed->kind == Target::Kind::kStreams) {
      task.listing = static_cast<double>(context().hub.size() * (1 + grant_->patterns())) / kNamesPerRequest;
    }
    return task;
  }

  Task refused(const Denial& denial) {
    return {[this, denial] { answer_denial(denial); }};
  }

  /// Moves this connection's place to `grant`.
  Result<void> take_place(Grant& grant) {
    return grant.take_place(static_cast<std::int64_t>(context().loops.connections_total()) - 1, grant_.get());
  }

  bool refuse(const Denial& denial) {
    answer_denial(denial);
    return false;
  }
  bool refuse(HttpStatus status, ErrorCode code, const std::string& why, HttpHeaders headers = {}) {
    answer_error(status, fail(code, why), std::move(headers));
    return false;
  }

  void answer_preflight() {
    answer(HttpStatus::kNoContent, {},
           {{"Access-Control-Allow-Methods", "GET, HEAD, PUT"},
            {"Access-Control-Allow-Headers", "Authorization, Content-Type, If-None-Match, If-Range, Range"},
            {"Access-Control-Max-Age", "600"}});
  }

  void serve(const Target& target) {
    switch (target.kind) {
      case Target::Kind::kPublish:
      case Target::Kind::kSubscribe:
      case Target::Kind::kEcho:
        return upgrade(target);
      case Target::Kind::kStreams:
        return serve_streams(target.query);
      case Target::Kind::kAsset:
        return serve_asset(*Sha256::from_hex(target.name));
      case Target::Kind::kPage:
      case Target::Kind::kWebFile:
        break;  // Need no rights: admitted() serves them.
    }
  }

  void serve_streams(std::string_view query) {
    if (!reads()) return refuse_method("the stream list is read by GET or HEAD", "GET, HEAD");
    const auto after = page_from_query(query);
    if (!after) return answer_error(HttpStatus::kBadRequest, after.error());
    const auto may_see = [this](std::string_view name) { return grant_->may_see(name); };
    answer(HttpStatus::kOk, page_of_streams(context().hub, *after, kMaxListed, may_see),
           {{"Cache-Control", "no-store"}});
  }

  void serve_asset(const Sha256& id) {
    if (!reads() && method() != "PUT") return refuse_method("assets take GET, HEAD and PUT", "GET, HEAD, PUT");
    const auto may = reads() ? grant_->may_fetch_assets() : grant_->may_store_assets();
    if (!may) return answer_denial({403, may.error().message});
    return reads() ? send_asset(*this, *grant_, id) : receive_asset(*this, *grant_, id);
  }

  void upgrade(const Target& target) {
    const bool echoes = target.kind == Target::Kind::kEcho;
    // Rights first, so that a request without an upgrade reports missing ones (docs/protocol.md, section 9).
    if ((!echoes && !may_begin(target)) || !is_upgrade(echoes)) return;
    // What it holds would be charged to nobody. Who has read it has acknowledged it with the request.
    if (has_unread_answer()) return answer_limit("read the answers to the requests before this one first");
#ifdef EIGENCAST_TEST_ENDPOINTS
    if (echoes) {
      widen_receive_buffer();
      disarm();
      return std::make_shared<Echo>(context(), std::move(transport()), std::move(grant_))
          ->start(websocket::upgrade_answer(header("Sec-WebSocket-Key"), {}, "eigencast-broker"));
    }
#endif
    if (target.kind == Target::Kind::kPublish) return publish(target.name);
    if (target.name.empty()) return subscribe({});
    const auto profile = profile_from_query(target.query);
    if (!profile) return answer_error(HttpStatus::kBadRequest, profile.error());
    subscribe(control::Subscribe{target.name, *profile});
  }

  bool may_begin(const Target& target) {
    const auto right = target.kind == Target::Kind::kPublish ? grant_->may_publish(target.name)
                       : target.name.empty()                 ? grant_->may_fetch_assets()
                                                             : grant_->may_subscribe(target.name);
    if (!right) return refuse({403, right.error().message});
    return !context().draining ||
           refuse(HttpStatus::kServiceUnavailable, ErrorCode::kRefused, "the broker is stopping");
  }

  /// Whether the request asks for a WebSocket of this broker (RFC 6455, 4.2.1).
  bool is_upgrade(bool any_protocol) {
    if (has_body()) {
      return refuse(HttpStatus::kBadRequest, ErrorCode::kInvalidArgument, "a request for a WebSocket has no body");
    }
    if (!is_websocket_upgrade()) {
      return refuse(HttpStatus::kUpgradeRequired, ErrorCode::kInvalidArgument,
                    "this is a WebSocket: connect with ws://", {{"Upgrade", "websocket"}});
    }
    if (header("Sec-WebSocket-Version") != "13") {
      return refuse(HttpStatus::kUpgradeRequired, ErrorCode::kIncompatibleVersion,
                    "Sec-WebSocket-Version must be 13 (RFC 6455)",
                    {{"Upgrade", "websocket"}, {"Sec-WebSocket-Version", "13"}});
    }
    if (!websocket::is_key(header("Sec-WebSocket-Key"))) {
      return refuse(HttpStatus::kBadRequest, ErrorCode::kInvalidArgument,
                    "Sec-WebSocket-Key must be 16 bytes in base64 (RFC 6455)");
    }
    return any_protocol || offers_subprotocol(joined_headers("Sec-WebSocket-Protocol")) ||
           refuse(HttpStatus::kBadRequest, ErrorCode::kIncompatibleVersion,
                  "offer the subprotocol '" + std::string(control::kSubprotocol) +
                      "' (Sec-WebSocket-Protocol): this broker speaks no other");
  }

  std::string upgrade_answer() {
    return websocket::upgrade_answer(header("Sec-WebSocket-Key"), control::kSubprotocol,
                                     "eigencast-broker/" + context().version);
  }

  void publish(const std::string& stream) {
    const auto taken = grant_->take(Resource::kPublisher);
    if (!taken) return answer_limit(taken.error().message);
    widen_receive_buffer();
    disarm();
    std::string answer = upgrade_answer();
    std::make_shared<Publisher>(context(), std::move(transport()), std::move(grant_), stream)->start(std::move(answer));
  }

  /// `first`: the stream of the URL.
  void subscribe(std::optional<control::Subscribe> first) {
    transport().widen_receive_buffer(nullptr);
    disarm();
    std::string answer = upgrade_answer();
    Context& there = context().loops.least_busy();
    if (&there == &context()) {
      return std::make_shared<Subscriber>(there, std::move(transport()), std::move(grant_), std::move(first))
          ->start(std::move(answer));
    }
    asio::post(there.loop, [&there, counted = counted_in(there.connection_count),
                            transport = Transport(there.loop, std::move(transport())), grant = std::move(grant_),
                            first = std::move(first), answer = std::move(answer)]() mutable {
      std::make_shared<Subscriber>(there, std::move(transport), std::move(grant), std::move(first))
          ->start(std::move(answer));
    });
  }

  ConnectionCount counted_;
  RateLimiter requests_;
  double connection_us_ = kConnectionUs;  ///< Until its first request is paid for.
  double unpaid_us_ = 0;                  ///< What a proxy's next client will pay.
  GrantPtr grant_;                        ///< The connection's at first, then the latest requester's.
  GrantPtr proxy_;                        ///< The connection's, if that is a trusted proxy's, else null.
};

}  // namespace

void turn_away(Context& context, Transport transport, const Denial& denial) {
  ++context.counters.connections_refused;
  log(context.log, LogLevel::kInfo,
      "turned away " + peer_of(transport.socket()).text() + " (" + std::to_string(denial.status) +
          "): " + denial.message);
  if (transport.is_tls()) return;  // No handshake for whom there is no room.
  const std::string body = R"({"error":"refused","message":")" + denial.message + "\"}\n";
  const std::string answer =
      "HTTP/1.1 " + std::to_string(denial.status) +
      (denial.status == 429 ? " Too Many Requests" : " Service Unavailable") +
      "\r\nRetry-After: " + std::to_string(denial.retry_after_s) +
      "\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: " + std::to_string(body.size()) +
      "\r\n\r\n" + body;
  transport.send({reinterpret_cast<const std::uint8_t*>(answer.data()), answer.size()});
  transport.end_writing();
  transport.read(context.read_buffer);  // A close before that resets.
}

void serve_data(Context& context, Transport transport) {
  const auto open = static_cast<std::int64_t>(context.loops.connections_total());
  auto accepted = context.gate.accept(peer_of(transport.socket()), open, steady_now_us());
  if (const auto* denial = std::get_if<Denial>(&accepted)) return turn_away(context, std::move(transport), *denial);
  std::make_shared<HttpSession>(context, std::move(transport), std::get<GrantPtr>(std::move(accepted)))->start();
}

}  // namespace eigencast::broker
