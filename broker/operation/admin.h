// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context/context.h"
#include "broker/relay/shares.h"
#include "broker/sockets/net.h"

namespace eigencast::broker {

/// Serves one request on a connection of the admin port (docs/operations.md lists the paths), if its address has one
/// free of its share of the 64 in `open`.
void serve_admin(Context& context, Socket socket, Shares& open);

/// The status page with the nonce of its Content-Security-Policy.
std::string status_page(const std::string& nonce);

}  // namespace eigencast::broker
