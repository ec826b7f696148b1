// SPDX-License-Identifier: MIT
#include <cstdlib>

#include "common/wire/control.h"

using namespace eigencast;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string input(data, data + size);
  if (const auto message = control_from_text(input)) {
    const std::string text = text_from_control(*message);
    const auto again = control_from_text(text);
    if (!again || text_from_control(*again) != text) std::abort();
  }
  if (const auto profile = profile_from_query(input)) {
    const auto again = profile_from_query(query_from_profile(*profile));
    if (!again || *again != *profile) std::abort();
  }
  if (check_stream_name(input) && input.size() > 128) std::abort();
  return 0;
}
