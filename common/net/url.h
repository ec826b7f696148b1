// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast {

/// Where a broker and, if the path names one, a stream are: ws://host[:port]/stream/name?rate=raw (http:// is the same
/// to us).
struct BrokerUrl {
  bool tls = false;  ///< wss:// or https://
  std::string host;  ///< Name or address; IPv6 without its brackets.
  std::uint16_t port = 7490;
  std::string
      stream;  ///< Without a leading '/'; "/v1/subscribe/" or "/v1/publish/" in front is taken off. May be empty.
  std::string query;  ///< Without '?'.

  std::string origin() const;  ///< "ws://host:port"
};

/// Errors: kInvalidArgument, saying what is wrong and what a URL looks like.
Result<BrokerUrl> parse_broker_url(std::string_view text);

/// Whether this version can speak to the URL's broker at all. Errors: kUnsupported (TLS).
Result<void> check_transport(const BrokerUrl& url);

}  // namespace eigencast
