// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <string>

#include "common/core/result.h"
#include "common/net/url.h"

namespace eigencast {

/// Asks a broker whether it would let this connection in, without making it: nobody else notices.
///   endpoint  such as "/v1/publish/lab/horse"
///   silence   how long nothing may come
/// Errors: kRefused: it is there and says no in a way that only people can change (token, right, certificate);
/// kUnreachable, kTimeout, kDisconnected: it is not there now, or what answers is not a broker; kInvalidArgument (files
/// of certificates).
Result<void> probe(const BrokerUrl& url, const std::string& endpoint, std::chrono::milliseconds silence);

}  // namespace eigencast
