// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context.h"
#include "broker/operation/facts.h"

namespace eigencast::broker {

// What the admin API answers: JSON texts. On the first loop's thread, whose context it is; the facts are of all loops.

std::string streams_report(const Context& context, const Facts& facts);
std::string clients_report(const Facts& facts);
std::string recordings_report(const Context& context);
/// The broker as a whole: version, uptime, totals.
std::string broker_report(const Context& context, const Facts& facts);

/// The status page; `nonce` is that of its Content-Security-Policy.
std::string status_page(const std::string& nonce);

}  // namespace eigencast::broker
