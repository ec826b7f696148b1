// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "common/core/bytes.h"

namespace eigencast {

/// RFC 4648: the standard alphabet with padding, or the URL-safe one without.
enum class Base64 { kStandard, kUrl };

std::string base64_from_bytes(ByteView bytes, Base64 alphabet = Base64::kStandard);
/// Strict: no blanks, exact padding, unused bits 0, so that every value has one spelling. Nothing: not base64.
std::optional<Bytes> bytes_from_base64(std::string_view text, Base64 alphabet = Base64::kStandard);

}  // namespace eigencast
