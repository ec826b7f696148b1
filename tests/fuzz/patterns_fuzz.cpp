// SPDX-License-Identifier: MIT
// Stream patterns: pattern and name, split at a line end. No input crashes or takes long; a name without stars matches
// itself and only itself.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "broker/access/patterns.h"

using eigencast::broker::StreamPatterns;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(static_cast<const char*>(static_cast<const void*>(data)), size);
  const auto split = text.find('\n');
  const std::string pattern = text.substr(0, split);
  const std::string name = split == std::string::npos ? pattern : text.substr(split + 1);
  const auto made = StreamPatterns::from(std::vector<std::string>{pattern});
  if (!made) return 0;
  const bool matches = made->matches(name);
  if (pattern.find('*') == std::string::npos && matches != (pattern == name)) std::abort();
  if (pattern == "**" && !matches) std::abort();
  return 0;
}
