// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context.h"

namespace eigencast::broker {

/// Serves one connection of the admin port: /livez, /readyz, /version, /metrics. One request, one answer.
void serve_admin(Context& context, Socket socket);

/// The metrics in Prometheus's text format, 0.0.4.
std::string metrics_text(const Context& context);

}  // namespace eigencast::broker
