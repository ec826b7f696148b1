// SPDX-License-Identifier: MIT
#include "broker/http/upgrade_request.h"

#include <algorithm>
#include <string>
#include <string_view>

#include "broker/websocket/upgrade.h"
#include "common/core/text.h"
#include "common/wire/control.h"

namespace eigencast::broker {
namespace {

bool offers_subprotocol(std::string_view header) {
  const auto parts = split(header, ',');
  return std::any_of(parts.begin(), parts.end(), [](auto part) { return trimmed(part) == control::kSubprotocol; });
}

}  // namespace

std::optional<UpgradeFault> fault_of_upgrade(const HttpConnection& connection, bool any_protocol) {
  if (!connection.is_websocket_upgrade()) {
    return UpgradeFault{HttpStatus::kUpgradeRequired,
                        fail(ErrorCode::kInvalidArgument, "this is a WebSocket: connect with ws://"),
                        {{"Upgrade", "websocket"}}};
  }
  if (connection.header("Sec-WebSocket-Version") != "13") {
    return UpgradeFault{HttpStatus::kUpgradeRequired,
                        fail(ErrorCode::kIncompatibleVersion, "Sec-WebSocket-Version must be 13 (RFC 6455)"),
                        {{"Upgrade", "websocket"}, {"Sec-WebSocket-Version", "13"}}};
  }
  if (!websocket::is_key(connection.header("Sec-WebSocket-Key"))) {
    return UpgradeFault{HttpStatus::kBadRequest,
                        fail(ErrorCode::kInvalidArgument, "Sec-WebSocket-Key must be 16 bytes in base64 (RFC 6455)")};
  }
  if (!any_protocol && !offers_subprotocol(connection.joined_headers("Sec-WebSocket-Protocol"))) {
    return UpgradeFault{HttpStatus::kBadRequest, fail(ErrorCode::kIncompatibleVersion,
                                                      "offer the subprotocol '" + std::string(control::kSubprotocol) +
                                                          "' (Sec-WebSocket-Protocol): this broker speaks no other")};
  }
  return std::nullopt;
}

}  // namespace eigencast::broker
