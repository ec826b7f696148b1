// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "broker/http/http_connection.h"

namespace eigencast::broker {

/// The answer to an upgrade that is refused.
struct UpgradeFault {
  HttpStatus status;
  Error error;
  HttpHeaders headers = {};
};

/// What the current request lacks to become a WebSocket of this broker (RFC 6455, 4.2.1); nothing: it is complete. Safe
/// on hostile input.
///   any_protocol whether it need not offer our subprotocol
std::optional<UpgradeFault> fault_of_upgrade(const HttpConnection& connection, bool any_protocol);

}  // namespace eigencast::broker
