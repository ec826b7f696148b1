// SPDX-License-Identifier: MIT
#include "tools/latency/presenter.h"

#include <cstdio>

namespace eigencast::latency {

constexpr int kMaxSide = 8192;

Result<PictureSize> picture_size_from_text(const std::string& text) {
  PictureSize size;
  int end = 0;
  if (std::sscanf(text.c_str(), "%dx%d%n", &size.width, &size.height, &end) != 2 ||
      end != static_cast<int>(text.size()) || size.width < 1 || size.height < 1 || size.width > kMaxSide ||
      size.height > kMaxSide)
    return fail(ErrorCode::kInvalidArgument, "--present " + text + ": must be WIDTHxHEIGHT, for example 1440x900");
  return size;
}

}  // namespace eigencast::latency
