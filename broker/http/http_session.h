// SPDX-License-Identifier: MIT
#pragma once

#include "broker/access/policy.h"
#include "broker/context/context.h"
#include "broker/sockets/transport.h"

namespace eigencast::broker {

/// Serves a connection of the data port: assets, the stream list, and WebSocket upgrades, which move the socket to a
/// Publisher or Subscriber.
void serve_data(Context& context, Transport transport);

/// One try without waiting: nobody who is turned away lingers.
void turn_away(Context& context, Transport transport, const Denial& denial);

}  // namespace eigencast::broker
