// SPDX-License-Identifier: MIT
#include "broker/http/access_facts.h"

#include <utility>

namespace eigencast::broker {
namespace {

std::string text_of(const beast::http::fields& headers, const char* name) {
  const auto value = headers[name];
  return {value.data(), value.size()};
}

/// All fields of one name, in their order: what a client put there before does not hide what a proxy added.
std::string joined(const beast::http::fields& headers, const char* name) {
  std::string all;
  const auto range = headers.equal_range(name);
  for (auto it = range.first; it != range.second; ++it) {
    all += all.empty() ? "" : ",";
    all.append(it->value().data(), it->value().size());
  }
  return all;
}

}  // namespace

IpAddress peer_of(const Socket& socket) {
  ErrorOf gone;
  const auto endpoint = socket.remote_endpoint(gone);
  return gone ? IpAddress{} : IpAddress::from_text(endpoint.address().to_string()).value_or(IpAddress{});
}

AccessRequest access_request_from(const beast::http::fields& headers, const IpAddress& peer, std::string query_token) {
  AccessRequest request;
  request.peer = peer;
  request.authorization = text_of(headers, "Authorization");
  request.query_token = std::move(query_token);
  request.origin = text_of(headers, "Origin");
  request.host = text_of(headers, "Host");
  request.forwarded_host = text_of(headers, "X-Forwarded-Host");
  request.forwarded = {joined(headers, "X-Forwarded-For"), joined(headers, "Forwarded")};
  return request;
}

}  // namespace eigencast::broker
