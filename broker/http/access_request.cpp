// SPDX-License-Identifier: MIT
#include "broker/http/access_request.h"

#include <utility>

namespace eigencast::broker {
IpAddress peer_of(const Socket& socket) {
  ErrorOf gone;
  const auto endpoint = socket.remote_endpoint(gone);
  return gone ? IpAddress{} : IpAddress::from_text(endpoint.address().to_string()).value_or(IpAddress{});
}

AccessRequest access_request_from(const HttpConnection& connection, std::string query_token) {
  AccessRequest request;
  request.peer = connection.peer();
  request.authorization = connection.header("Authorization");
  request.query_token = std::move(query_token);
  request.origin = connection.header("Origin");
  request.host = connection.header("Host");
  request.forwarded_host = connection.header("X-Forwarded-Host");
  // All fields: one that a client sent must not hide those that a proxy added.
  request.forwarded = {connection.joined_headers("X-Forwarded-For"), connection.joined_headers("Forwarded")};
  return request;
}

}  // namespace eigencast::broker
