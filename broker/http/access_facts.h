// SPDX-License-Identifier: MIT
#pragma once

#include <boost/beast/http/fields.hpp>
#include <string>

#include "broker/access/policy.h"
#include "broker/connections/net.h"

namespace eigencast::broker {

/// The address at the other end; all zeros once it is gone.
IpAddress peer_of(const Socket& socket);

/// What a request says of its sender. `query_token` is the access_token of its target.
AccessRequest access_request_from(const beast::http::fields& headers, const IpAddress& peer, std::string query_token);

}  // namespace eigencast::broker
