// SPDX-License-Identifier: MIT
#pragma once

#include "broker/http/http_connection.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

// Both keep the connection alive meanwhile; `grant` outlives the answer. The disk's threads read and write files.

/// Answers a GET or HEAD: all of the asset or a range, or 304, 404, 416, 429.
void send_asset(HttpConnection& connection, Grant& grant, const Sha256& id);
/// Answers a PUT: 201, or 200 if the asset exists, or 401 (its token ends meanwhile), 403, 408, 413,
/// 422 (the bytes have another hash than `id`), 429, 503, 507.
void receive_asset(HttpConnection& connection, Grant& grant, const Sha256& id);

}  // namespace eigencast::broker
