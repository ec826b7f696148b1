// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast::broker {

/// With which a sender takes its own stream over: 256 random bits as hexadecimal digits. Errors: kInternal (the system
/// gives none).
Result<std::string> new_resume_secret();

/// What brokers keep of it: a hash, 64 hexadecimal digits, from which it cannot be found. To a sender with another
/// token the secret is worth nothing: `token` is its Identity::key.
std::string resume_proof(std::string_view secret, std::string_view token);

}  // namespace eigencast::broker
