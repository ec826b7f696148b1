// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <string_view>

#include "broker/relay/hub.h"

namespace eigencast::broker {

/// The answer to GET /v1/streams: the announced streams with names after `after` that `may_see` allows, `max` at most,
/// and in `next` the last one's name if more follow. REQUIRES: max > 0.
std::string page_of_streams(const Hub& hub, std::string_view after, std::size_t max,
                            const std::function<bool(std::string_view)>& may_see);

}  // namespace eigencast::broker
