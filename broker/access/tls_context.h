// SPDX-License-Identifier: MIT
#pragma once

#include <openssl/types.h>

#include <cstdint>
#include <memory>

#include "broker/config/config.h"

namespace eigencast::broker {

/// A TLS server's certificate, key and rules, ready for connections; a renewed certificate is a new one. Null: the
/// configuration asks for no TLS. TLS 1.2 or newer, no renegotiation, no compression, ALPN http/1.1.
/// Errors: kInvalidArgument, kNotFound, kRefused (others can read the key), naming the setting and the file.
Result<std::shared_ptr<SSL_CTX>> make_tls_context(const Config& config);

/// When the certificate ends, Unix seconds. REQUIRES: made by make_tls_context()
std::int64_t certificate_expires_s(const SSL_CTX* context);

}  // namespace eigencast::broker
