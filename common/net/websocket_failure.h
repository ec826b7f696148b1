// SPDX-License-Identifier: MIT
#pragma once

#include <boost/beast/websocket/rfc6455.hpp>
#include <chrono>
#include <string>
#include <string_view>

#include "common/core/result.h"
#include "common/net/client_stream.h"
#include "common/net/url.h"

namespace eigencast {

/// After what only people can put right: a missing right, an expired token, a certificate that nobody vouches for.
inline constexpr std::chrono::milliseconds kHopelessRetry{30'000};

/// Why a connection ended, for people and for the next try.
struct WebSocketFailure {
  Error error;
  bool refused = false;
  /// Not before somebody gets a new token or certificate, or not before so long.
  std::chrono::milliseconds min_wait{0};
  bool for_good = false;  ///< Trying again would take away what somebody else was given.
};

WebSocketFailure failure_of_handshake(const boost::system::error_code& ec, const ClientStream& stream,
                                      const BrokerUrl& url);

/// A broker answered a request for a WebSocket with a status other than success, and this body.
WebSocketFailure failure_of_answer(unsigned status, std::string_view body, const std::string& where, bool has_token);

/// The upgrade to a WebSocket was refused, or something else answered.
WebSocketFailure failure_of_upgrade(const boost::system::error_code& ec,
                                    const boost::beast::websocket::response_type& response, const std::string& where,
                                    bool has_token);

WebSocketFailure failure_of_close(const boost::system::error_code& ec,
                                  const boost::beast::websocket::close_reason& reason, const std::string& where);

}  // namespace eigencast
