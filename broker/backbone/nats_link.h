// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "broker/backbone/link.h"

namespace eigencast::broker {

struct Config;

/// A Link over NATS by the settings of [backbone]: subjects and requests of core NATS, and a JetStream key-value bucket
/// as the table.
///   id       of this broker: its subjects end in it or go on with it, so that permissions can pin them to it
///   on_loop  runs work on the event loop; thread-safe
/// Errors: kInvalidArgument, kIo (options refused by libnats).
Result<std::shared_ptr<Link>> make_nats_link(const Config& config, const std::string& id,
                                             std::function<void(std::function<void()>)> on_loop);

}  // namespace eigencast::broker
