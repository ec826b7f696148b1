// SPDX-License-Identifier: MIT
#include "broker/relay/ownership.h"

#include <algorithm>
#include <fstream>

#include "common/core/files.h"

namespace eigencast::broker {
namespace {
constexpr std::uint64_t kStartOf2026 = 1'767'225'600;
}

Result<EpochSource> EpochSource::open(std::string path) {
  std::uint32_t last = 0;
  if (std::ifstream file(path); file && !(file >> last)) {
    return fail(ErrorCode::kCorrupt,
                path + " holds no number: remove it if no viewer is connected, epochs start anew then");
  }
  return EpochSource(std::move(path), last);
}

Result<std::uint32_t> EpochSource::next(std::uint64_t unix_seconds, std::uint32_t above) {
  const std::uint64_t by_time = unix_seconds > kStartOf2026 ? unix_seconds - kStartOf2026 : 0;
  const auto epoch =
      static_cast<std::uint32_t>(std::max<std::uint64_t>(std::uint64_t{std::max(last_, above)} + 1, by_time));
  if (auto kept = write_file_atomically(path_, std::to_string(epoch) + "\n"); !kept) return kept.error();
  last_ = epoch;
  return epoch;
}

}  // namespace eigencast::broker
