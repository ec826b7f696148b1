// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/access/policy.h"
#include "broker/http/http_connection.h"
#include "broker/sockets/net.h"

namespace eigencast::broker {

/// The peer's address; all zeros once it is gone.
IpAddress peer_of(const Socket& socket);

/// What the current request says about its sender. `query_token` is the access_token of its target.
AccessRequest access_request_from(const HttpConnection& connection, std::string query_token);

}  // namespace eigencast::broker
