// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context.h"

namespace eigencast::broker {

// What the admin API answers: JSON texts. On the loop's thread.

std::string streams_report(const Context& context);
std::string clients_report(const Context& context);
std::string recordings_report(const Context& context);
/// The broker as a whole: version, uptime, totals.
std::string broker_report(const Context& context);

/// The status page; `nonce` is that of its Content-Security-Policy.
std::string status_page(const std::string& nonce);

}  // namespace eigencast::broker
