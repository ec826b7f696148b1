// SPDX-License-Identifier: MIT
#pragma once

#include <openssl/types.h>

#include <cstdint>
#include <memory>

#include "broker/config/config.h"

namespace eigencast::broker {

/// Null: TLS is off. TLS 1.2 or newer, no renegotiation, no compression, ALPN http/1.1.
/// Errors: kInvalidArgument, kNotFound, kRefused (others can read the key); the message names the setting and the file.
Result<std::shared_ptr<SSL_CTX>> make_tls_context(const Config& config);

/// Expiry of the certificate, Unix seconds. REQUIRES: made by make_tls_context()
std::int64_t certificate_expires_s(const SSL_CTX* context);

}  // namespace eigencast::broker
