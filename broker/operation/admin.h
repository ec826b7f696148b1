// SPDX-License-Identifier: MIT
#pragma once

#include "broker/context/context.h"
#include "broker/sockets/net.h"

namespace eigencast::broker {

/// Serves one request on a connection of the admin port (docs/operations.md lists the paths).
void serve_admin(Context& context, Socket socket);

}  // namespace eigencast::broker
