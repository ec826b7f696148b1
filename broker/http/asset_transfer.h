// SPDX-License-Identifier: MIT
#pragma once

#include <optional>

#include "broker/http/http_connection.h"
#include "broker/websocket/reader.h"
#include "common/core/clock.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker {

/// How far an upload is behind the pace of messages (MessageReader::kUsPerByte), on average; only the time that the
/// broker waits for its bytes counts.
class UploadPace {
 public:
  void begin_reading(TimeUs now_us) { since_us_ = now_us; }
  void end_reading(TimeUs now_us, std::size_t bytes) {
    behind_us_ = behind_us(now_us) - websocket::MessageReader::kUsPerByte * static_cast<TimeUs>(bytes);
    since_us_.reset();
  }
  TimeUs behind_us(TimeUs now_us) const { return behind_us_ + (since_us_ ? now_us - *since_us_ : 0); }

 private:
  TimeUs behind_us_ = 0;
  std::optional<TimeUs> since_us_;
};

// Both keep the connection alive meanwhile; `grant` outlives the answer. The disk's threads read and write files.

/// Answers a GET or HEAD: all of the asset or a range, or 304, 404, 416, 429.
void send_asset(HttpConnection& connection, Grant& grant, const Sha256& id);
/// Answers a PUT: 201, or 200 if the asset exists, or 401 (its token ends meanwhile), 403, 408, 413,
/// 422 (the bytes have another hash than `id`), 429, 503, 507.
void receive_asset(HttpConnection& connection, Grant& grant, const Sha256& id);

}  // namespace eigencast::broker
