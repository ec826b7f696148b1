// SPDX-License-Identifier: MIT
#pragma once

#include "broker/context.h"

namespace eigencast::broker {

/// Serves one connection of the admin port: health, metrics, status page, admin API (docs/operations.md lists the
/// paths). One request, one answer.
void serve_admin(Context& context, Socket socket);

}  // namespace eigencast::broker
