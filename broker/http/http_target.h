// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"

namespace eigencast::broker {

struct Target {
  enum class Kind { kStreams, kAsset, kPublish, kSubscribe, kPage, kWebFile, kEcho };
  Kind kind = Kind::kStreams;  ///< kEcho: builds with EIGENCAST_TEST_ENDPOINTS only.
  std::string name;            ///< Stream, asset, or file below /v1/web/; empty for /, /v1/streams and /v1/subscribe.
  std::string query;           ///< Without '?', and without access_token.
  std::string token;           ///< access_token of the query; empty: none.
};

/// Parses a request target, with or without the `prefix` that a proxy left in it. Safe on hostile input.
/// Errors: kNotFound (no such path), kInvalidArgument (an invalid stream name or hash, two tokens).
Result<Target> target_from_text(std::string_view text, std::string_view prefix = {});

/// The bytes [first, last], for kPart.
struct RangeRequest {
  enum class Kind { kWhole, kPart, kUnsatisfiable };
  Kind kind = Kind::kWhole;
  std::uint64_t first = 0;
  std::uint64_t last = 0;
};

/// Parses a Range header. Several ranges, other units and malformed headers are ignored, as RFC 9110 14.2 allows.
RangeRequest range_from_header(std::string_view header, std::uint64_t size);

/// The thousandths that a header such as Accept gives each of `names`; -1: it does not name it (RFC 9110, 12.4.2), or
/// only after its first 256 bytes.
std::vector<int> weights_of(std::string_view header, std::initializer_list<std::string_view> names);

/// Whether an If-None-Match header matches this entity tag (with its quotes).
bool etag_matches(std::string_view header, std::string_view etag);

}  // namespace eigencast::broker
