// SPDX-License-Identifier: MIT
#pragma once

#include "broker/http/http_connection.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

// Both answer the current request of `connection` and keep the connection alive meanwhile. `grant` is the requester's and
// outlives the answer. The disk's threads read and write files.

/// Answers a GET or HEAD of an asset: all of it or a range, or 304, 404, 416, 429.
void send_asset(HttpConnection& connection, Grant& grant, const Sha256& id);
/// Answers a PUT: 201, or 200 if the asset exists. The asset becomes visible once its bytes have the hash `id`. Errors:
/// 403, 413, 422 (wrong hash), 429, 503, 507.
void receive_asset(HttpConnection& connection, Grant& grant, const Sha256& id);

}  // namespace eigencast::broker
