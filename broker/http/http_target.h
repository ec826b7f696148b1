// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast::broker {

/// What a request target of the data port names.
struct Target {
  enum class Kind { kStreams, kAsset, kPublish, kSubscribe, kEcho };
  Kind kind = Kind::kStreams;  ///< kEcho: builds with EIGENCAST_TEST_ENDPOINTS only.
  std::string name;            ///< Stream or asset; empty for /v1/streams and /v1/subscribe.
  std::string query;           ///< Without '?', and without access_token.
  std::string token;           ///< access_token of the query; empty: none.
};

/// Takes a request target apart, with or without `prefix` (that a proxy left) before it. Safe on hostile input.
/// Errors: kNotFound (no such path), kInvalidArgument (a stream name or hash that is none, two tokens).
Result<Target> target_from_text(std::string_view text, std::string_view prefix = {});

/// The bytes [first, last] of a range request.
struct ByteRange {
  std::uint64_t first = 0;
  std::uint64_t last = 0;
};

/// What a Range header asks of an object of `size` bytes.
struct RangeRequest {
  enum class Kind { kWhole, kPart, kUnsatisfiable };
  Kind kind = Kind::kWhole;
  ByteRange range;  ///< Of kPart.
};

/// Reads a Range header. One range is served; several, other units and malformed ones are ignored, as RFC 9110 14.2
/// allows.
RangeRequest range_from_header(std::string_view header, std::uint64_t size);

/// Whether an If-None-Match header names this entity tag (given with its quotes), or any by "*".
bool etag_matches(std::string_view header, std::string_view etag);

/// `text` as a JSON string with its quotes.
std::string json_quoted(std::string_view text);

}  // namespace eigencast::broker
