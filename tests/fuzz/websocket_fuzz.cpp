// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cstdlib>
#include <string>

#include "broker/websocket/reader.h"

using namespace eigencast;
using eigencast::broker::websocket::MessageReader;

namespace {

/// What a reader makes of a stream in pieces of `step` bytes, as text.
std::string read(const std::uint8_t* data, std::size_t size, std::size_t step) {
  MessageReader reader({1000, 2000});
  std::string seen;
  for (std::size_t at = 0; at < size; at += step) {
    Bytes piece(data + at, data + std::min(at + step, size));
    std::span<std::uint8_t> input(piece);
    while (const auto event = reader.next(input, 0)) {
      if (event->payload.size() > 2000) std::abort();
      seen += static_cast<char>('a' + static_cast<int>(event->kind));
      seen.append(event->payload.begin(), event->payload.end());
      seen += std::to_string(static_cast<int>(event->code)) + ";";
    }
    if (!input.empty()) std::abort();
  }
  return seen;
}

}  // namespace

/// The pieces in which a stream comes must not matter.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string whole = read(data, size, size + 1);
  for (const std::size_t step : {std::size_t{1}, std::size_t{3}, std::size_t{64}}) {
    if (read(data, size, step) != whole) std::abort();
  }
  return 0;
}
