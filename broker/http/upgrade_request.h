// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "broker/http/http_connection.h"

namespace eigencast::broker {

/// The answer to an upgrade that cannot be.
struct UpgradeFault {
  HttpConnection::Status status;
  Error error;
  HttpHeaders headers = {};
};

/// What `request` lacks to become a WebSocket of this broker (RFC 6455, 4.2.1); nothing: it can. Safe on hostile input.
///   more         bytes were sent behind the head, before the answer
///   any_protocol whether it need not offer our subprotocol
std::optional<UpgradeFault> fault_of_upgrade(const HttpConnection::Parser::value_type& request, bool more,
                                             bool any_protocol);

}  // namespace eigencast::broker
