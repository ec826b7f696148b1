// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <cstdint>

namespace eigencast {

/// The most that one holder, who has `own`, may have of something of which all together have `used` of `max`: a quarter
/// of what is free, and one as long as there is any, so that newcomers find room. Who is `spared` may have all but a
/// sixteenth of `max`, and what others may.
constexpr std::int64_t share_of(std::int64_t max, std::int64_t used, std::int64_t own, bool spared = false) {
  const std::int64_t rest = own + max - used;
  const std::int64_t usual = std::min(rest, std::max<std::int64_t>((max - used) / 4, 1));
  return spared ? std::max(rest - max / 16, usual) : usual;
}

}  // namespace eigencast
