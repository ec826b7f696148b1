// SPDX-License-Identifier: MIT
#include "common/net/websocket_failure.h"

#include <algorithm>
#include <boost/beast/core.hpp>
#include <boost/beast/websocket/error.hpp>
#include <charconv>

#include "common/core/text.h"

namespace eigencast {
namespace {

namespace beast = boost::beast;
namespace ws = boost::beast::websocket;
using boost::system::error_code;
using std::chrono::milliseconds;

/// Another sender was given the stream (docs/protocol.md, section 10).
constexpr std::uint16_t kReplaced = 4409;

/// What a broker's error body says to people; another server's body as it is.
std::string remark_of(std::string_view body) {
  constexpr std::string_view kMessage = "\"message\":\"";
  const auto at = body.find(kMessage);
  if (at == std::string_view::npos) return escaped(body.substr(0, 300));
  std::string out;
  for (std::size_t i = at + kMessage.size(); i < body.size() && body[i] != '"' && out.size() < 600; ++i) {
    if (body[i] == '\\' && i + 1 < body.size()) ++i;
    out += body[i];
  }
  return escaped(out);
}

/// The pause that a Retry-After header asks for, up to ten minutes; 0: none.
milliseconds retry_after_of(const ws::response_type& response) {
  const auto header = response[beast::http::field::retry_after];
  int seconds = 0;
  (void)std::from_chars(header.data(), header.data() + header.size(), seconds);
  return std::chrono::seconds(std::clamp(seconds, 0, 600));
}

std::string advice_for(unsigned status, bool has_token) {
  if (status == 401 && !has_token) return " (give a token with --token, or in EIGENCAST_TOKEN)";
  if (status == 401) return " (the token that was given does not do)";
  return {};
}

}  // namespace

WebSocketFailure failure_of_handshake(const error_code& ec, const ClientStream& stream, const BrokerUrl& url) {
  Error error = stream.handshake_failure(url, ec);
  const bool hopeless = error.code == ErrorCode::kRefused;
  return {std::move(error), hopeless, hopeless ? kHopelessRetry : milliseconds(0)};
}

WebSocketFailure failure_of_answer(unsigned status, std::string_view body, const std::string& where, bool has_token) {
  const std::string said = remark_of(body);
  const std::string text =
      where + " answered " + std::to_string(status) + (said.empty() ? "" : ": " + said) + advice_for(status, has_token);
  const bool hopeless = status == 401 || status == 403;
  if (status >= 400 && status < 500)
    return {fail(ErrorCode::kRefused, text), true, hopeless ? kHopelessRetry : milliseconds(0)};
  return {fail(ErrorCode::kUnreachable, text)};
}

WebSocketFailure failure_of_upgrade(const error_code& ec, const ws::response_type& response, const std::string& where,
                                    bool has_token) {
  if (ec != ws::error::upgrade_declined) {
    const bool hopeless = ClientStream::wants_certificate(ec);
    return {fail(hopeless ? ErrorCode::kRefused : ErrorCode::kUnreachable,
                 "no WebSocket at " + where + ": " + ec.message() + ClientStream::advice_on(ec, where)),
            hopeless, hopeless ? kHopelessRetry : milliseconds(0)};
  }
  WebSocketFailure failure = failure_of_answer(response.result_int(), response.body(), where, has_token);
  failure.min_wait = std::max(failure.min_wait, failure.refused ? retry_after_of(response) : milliseconds(0));
  return failure;
}

WebSocketFailure failure_of_close(const error_code& ec, const ws::close_reason& reason, const std::string& where) {
  if (ec == beast::error::timeout) return {fail(ErrorCode::kTimeout, where + " fell silent")};
  if (ec == ws::error::closed) {
    const bool refused = reason.code == ws::close_code::policy_error || reason.code == ws::close_code::protocol_error ||
                         reason.code == ws::close_code::bad_payload || reason.code == ws::close_code::unknown_data;
    const std::string said = escaped({reason.reason.data(), reason.reason.size()});
    const std::string text =
        where + " closed the connection (" + std::to_string(reason.code) + (said.empty() ? "" : ", " + said) + ")";
    const bool replaced = reason.code == kReplaced;
    const ErrorCode code = refused || replaced ? ErrorCode::kRefused : ErrorCode::kDisconnected;
    return {fail(code, text), refused, milliseconds(0), replaced};
  }
  return {fail(ErrorCode::kDisconnected, "connection to " + where + " lost: " + ec.message())};
}

}  // namespace eigencast
