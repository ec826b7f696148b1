// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>

#include "broker/config/config.h"

namespace eigencast::broker {

/// A token that views every stream, and nothing else, for kShareS. Errors: kInvalidArgument (access.jwt_secret).
Result<std::string> viewing_token(const Config& config, std::int64_t now_unix_s);
inline constexpr std::int64_t kShareS = 12 * 3600;

/// A QR code of `text` for a terminal of 256 colours; empty: built without libqrencode, or the text is too long.
std::string qr_code(const std::string& text);

}  // namespace eigencast::broker
