// SPDX-License-Identifier: MIT
#include "broker/http/upgrade_request.h"

#include <boost/beast/websocket/rfc6455.hpp>
#include <string>
#include <string_view>

#include "broker/websocket/upgrade.h"
#include "common/wire/control.h"

namespace eigencast::broker {
namespace {

namespace http = beast::http;
using Status = HttpConnection::Status;

bool offers_subprotocol(std::string_view header) {
  while (!header.empty()) {
    const auto comma = header.find(',');
    std::string_view one = header.substr(0, comma);
    while (!one.empty() && one.front() == ' ') one.remove_prefix(1);
    while (!one.empty() && one.back() == ' ') one.remove_suffix(1);
    if (one == control::kSubprotocol) return true;
    if (comma == std::string_view::npos) break;
    header.remove_prefix(comma + 1);
  }
  return false;
}

}  // namespace

std::optional<UpgradeFault> fault_of_upgrade(const HttpConnection::Parser::value_type& request, bool more,
                                             bool any_protocol) {
  if (!beast::websocket::is_upgrade(request) || more) {
    return UpgradeFault{Status::upgrade_required,
                        fail(ErrorCode::kInvalidArgument, "this is a WebSocket: connect with ws://"),
                        {{"Upgrade", "websocket"}}};
  }
  if (request[http::field::sec_websocket_version] != "13") {
    return UpgradeFault{Status::upgrade_required,
                        fail(ErrorCode::kIncompatibleVersion, "Sec-WebSocket-Version must be 13 (RFC 6455)"),
                        {{"Upgrade", "websocket"}, {"Sec-WebSocket-Version", "13"}}};
  }
  if (!websocket::is_key(std::string(request[http::field::sec_websocket_key]))) {
    return UpgradeFault{Status::bad_request,
                        fail(ErrorCode::kInvalidArgument, "Sec-WebSocket-Key must be 16 bytes in base64 (RFC 6455)")};
  }
  if (!any_protocol && !offers_subprotocol(std::string(request[http::field::sec_websocket_protocol]))) {
    return UpgradeFault{Status::bad_request, fail(ErrorCode::kIncompatibleVersion,
                                                  "offer the subprotocol '" + std::string(control::kSubprotocol) +
                                                      "' (Sec-WebSocket-Protocol): this broker speaks no other")};
  }
  return std::nullopt;
}

}  // namespace eigencast::broker
