// SPDX-License-Identifier: MIT
// Request targets and the headers that are read by hand: no input crashes, names are names, tokens leave the query.
#include <cstdint>
#include <cstdlib>
#include <string>

#include "broker/http/http_target.h"
#include "common/wire/control.h"

using namespace eigencast;
using namespace eigencast::broker;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(static_cast<const char*>(static_cast<const void*>(data)), size);
  for (const char* prefix : {"", "/eigencast"}) {
    const auto target = target_from_text(text, prefix);
    if (!target) continue;
    const bool stream = target->kind == Target::Kind::kPublish || target->kind == Target::Kind::kSubscribe;
    if (stream && !target->name.empty() && !check_stream_name(target->name)) std::abort();
    if (target->query.starts_with("access_token=") || target->query.find("&access_token=") != std::string::npos) {
      std::abort();
    }
  }
  const auto range = range_from_header(text, 1000);
  if (range.kind == RangeRequest::Kind::kPart && (range.first > range.last || range.last > 999)) {
    std::abort();
  }
  (void)etag_matches(text, "\"x\"");
  return 0;
}
