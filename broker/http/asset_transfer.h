// SPDX-License-Identifier: MIT
#pragma once

#include "broker/http/http_connection.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

// Both answer the request that is at hand on `connection`, and keep the connection alive meanwhile. `grant` is of who
// sent it, and outlives the answer. Files are read and written by the disk's threads.

/// A GET or HEAD of an asset: whole or a range of it, or 304, 404, 416, 429.
void send_asset(HttpConnection& connection, Grant& grant, const Sha256& id);
/// A PUT: 201, or 200 where the asset is there already; it is visible once its bytes have the hash `id`. Else 403, 413,
/// 422 (another hash), 429, 503, 507.
void receive_asset(HttpConnection& connection, Grant& grant, const Sha256& id);

}  // namespace eigencast::broker
