// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "broker/context/context.h"
#include "broker/operation/statistics.h"

namespace eigencast::broker {

// JSON answers of the admin API. Call on the first loop's thread with its context and the statistics of all loops.

std::string streams_report(const Context& context, const Statistics& statistics);
std::string clients_report(const Statistics& statistics);
std::string recordings_report(const Context& context);
std::string broker_report(const Context& context, const Statistics& statistics);

/// The status page with the nonce of its Content-Security-Policy.
std::string status_page(const std::string& nonce);

}  // namespace eigencast::broker
