// SPDX-License-Identifier: MIT
#include "broker/http/http_session.h"

#include <ctime>
#include <nlohmann/json.hpp>
#include <utility>

#include "broker/connections/echo.h"
#include "broker/connections/publisher.h"
#include "broker/connections/subscriber.h"
#include "broker/http/access_request.h"
#include "broker/http/asset_transfer.h"
#include "broker/http/upgrade_request.h"
#include "broker/loops/loops.h"
#include "broker/relay/hub.h"
#include "broker/websocket/upgrade.h"

namespace eigencast::broker {
namespace {

nlohmann::ordered_json json_of(const Stream& stream) {
  return {{"stream", stream.name()},
          {"stream_id", stream.id()},
          {"state", name_of(stream.state())},
          {"epoch", stream.epoch()},
          {"asset", stream.asset()},
          {"key_rate_hz", stream.key_rate_hz()},
          {"keys_received", stream.keys_received()},
          {"subscribers", stream.watchers()}};
}

}  // namespace

HttpSession::HttpSession(Context& context, Transport transport)
    : HttpConnection(context, std::move(transport)),
      counted_(context.connection_count),
      grant_(context.gate.accept(peer(), steady_now_us())) {
  ++context.counters.connections_total;
}

HttpConnection::Limits HttpSession::limits() const {
  const Config& config = context().config;
  return {config.timeouts.header_ms, config.timeouts.transfer_ms,
          static_cast<std::uint64_t>(config.assets.max_object_bytes), "assets.max_object_bytes"};
}

void HttpSession::decorate(HttpHeaders& headers) const {
  const std::string origin = header("Origin");
  if (origin.empty()) return;
  headers.emplace_back("Vary", "Origin");
  if (!context().gate.policy()->allows_origin(access_request_from(*this, {}))) return;
  headers.emplace_back("Access-Control-Allow-Origin", origin);
  headers.emplace_back("Access-Control-Expose-Headers", "Accept-Ranges, Content-Range, ETag, Retry-After");
}

void HttpSession::on_head() {
  const auto parsed = target_from_text(target(), context().config.proxy.path_prefix);
  if (!parsed) {
    const bool missing = parsed.error().code == ErrorCode::kNotFound;
    return answer_error(missing ? HttpStatus::kNotFound : HttpStatus::kBadRequest, parsed.error());
  }
  if (method() == HttpMethod::kOptions) return answer_preflight();
  if (admit(*parsed)) serve(*parsed);
}

bool HttpSession::admit(const Target& target) {
  if (!grant_) {
    answer_denial({429, "too many connections from this address (per_address.connections)", 1, false});
    return false;
  }
  auto admitted = context().gate.admit(access_request_from(*this, target.token), steady_now_us(), std::time(nullptr));
  if (const auto* denied = std::get_if<Denial>(&admitted)) {
    answer_denial(*denied);
    return false;
  }
  grant_.reset();  // First: it counts towards the same limit.
  grant_ = std::move(std::get<GrantPtr>(admitted));
  if (const auto taken = grant_->take(Resource::kConnection); !taken) {
    answer_denial({429, taken.error().message, 1, false});
    return false;
  }
  return true;
}

void HttpSession::answer_preflight() {
  answer(HttpStatus::kNoContent, {},
         {{"Access-Control-Allow-Methods", "GET, HEAD, PUT"},
          {"Access-Control-Allow-Headers", "Authorization, Content-Type, If-None-Match, If-Range, Range"},
          {"Access-Control-Max-Age", "600"}});
}

void HttpSession::serve(const Target& target) {
  switch (target.kind) {
    case Target::Kind::kPublish:
    case Target::Kind::kSubscribe:
    case Target::Kind::kEcho:
      return upgrade(target);
    case Target::Kind::kStreams:
      if (reads()) return serve_streams();
      return answer_error(HttpStatus::kMethodNotAllowed,
                          fail(ErrorCode::kUnsupported, "the stream list is read by GET or HEAD"),
                          {{"Allow", "GET, HEAD"}});
    case Target::Kind::kAsset: {
      if (!reads() && method() != HttpMethod::kPut) {
        return answer_error(HttpStatus::kMethodNotAllowed,
                            fail(ErrorCode::kUnsupported, "assets take GET, HEAD and PUT"),
                            {{"Allow", "GET, HEAD, PUT"}});
      }
      if (const auto may = reads() ? grant_->may_fetch_assets() : grant_->may_store_assets(); !may) {
        return answer_denial({403, may.error().message, 0, false});
      }
      const Sha256 id = *Sha256::from_hex(target.name);
      return reads() ? send_asset(*this, *grant_, id) : receive_asset(*this, *grant_, id);
    }
  }
}

void HttpSession::serve_streams() {
  auto list = nlohmann::ordered_json::array();
  for (const Stream* stream : context().hub.streams()) {
    if (grant_->may_see(stream->name())) list.push_back(json_of(*stream));
  }
  answer(HttpStatus::kOk, nlohmann::ordered_json{{"streams", list}}.dump() + "\n", {{"Cache-Control", "no-store"}});
}

void HttpSession::upgrade(const Target& target) {
  const bool echoes = target.kind == Target::Kind::kEcho;
  // First, so that a request without an upgrade reports missing rights (docs/protocol.md, section 9).
  if (!echoes && !may_begin(target)) return;
  if (auto fault = fault_of_upgrade(*this, echoes)) {
    return answer_error(fault->status, fault->error, std::move(fault->headers));
  }
#ifdef EIGENCAST_TEST_ENDPOINTS
  if (echoes) {
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

bool HttpSession::may_begin(const Target& target) {
  const auto right = target.kind == Target::Kind::kPublish ? grant_->may_publish(target.name)
                     : target.name.empty()                 ? grant_->may_fetch_assets()
                                                           : grant_->may_subscribe(target.name);
  if (!right) {
    answer_denial({403, right.error().message, 0, false});
    return false;
  }
  if (context().draining) {
    answer_error(HttpStatus::kServiceUnavailable, fail(ErrorCode::kRefused, "the broker is stopping"));
    return false;
  }
  return true;
}

std::string HttpSession::upgrade_answer() {
  return websocket::upgrade_answer(header("Sec-WebSocket-Key"), control::kSubprotocol,
                                   "eigencast-broker/" + context().version);
}

void HttpSession::publish(const std::string& stream) {
  if (const auto taken = grant_->take(Resource::kPublisher); !taken) {
    return answer_denial({429, taken.error().message, 1, false});
  }
  disarm();
  std::string answer = upgrade_answer();
  std::make_shared<Publisher>(context(), std::move(transport()), std::move(grant_), stream)->start(std::move(answer));
}

void HttpSession::subscribe(std::optional<control::Subscribe> first) {
  disarm();
  std::string answer = upgrade_answer();
  Context& there = context().loops.least_busy();
  if (&there == &context()) {
    return std::make_shared<Subscriber>(there, std::move(transport()), std::move(grant_), std::move(first))
        ->start(std::move(answer));
  }
  asio::post(there.loop, [&there, counted = ConnectionCount(there.connection_count), transport = transport().detach(),
                          grant = std::move(grant_), first = std::move(first), answer = std::move(answer)]() mutable {
    std::make_shared<Subscriber>(there, Transport(there.loop, std::move(transport)), std::move(grant), std::move(first))
        ->start(std::move(answer));
  });
}

}  // namespace eigencast::broker
