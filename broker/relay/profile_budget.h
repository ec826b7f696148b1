// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <span>

#include "common/wire/control.h"

namespace eigencast::broker {

/// Whether a stream serves the profile beyond its budget too: raw, or k = 3 with the default scheme of its rate. They
/// are few, so that no viewer's unusual wishes cost others these.
bool is_common(const Profile& profile);
constexpr std::size_t kCommonProfiles = 3 * 8;  ///< Of three rates and up to eight bands.

/// What the budget of a stream is charged: 1, and 1 for each pose that is encoded per key. REQUIRES: not raw.
std::size_t cost_of(const Profile& profile);

/// The profile to serve in place of `asked`: the nearest of those `served` already, of the common ones if `common`, and
/// raw. It never has more bands or poses than `asked`, nor a scheme that its receiver need not know. Lost are, as late
/// as possible, bands, then the rate (raw), the scheme (the default), and poses per key.
Profile nearest_profile(const Profile& asked, std::span<const Profile> served, bool common = true);

}  // namespace eigencast::broker
