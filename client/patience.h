// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// When to give up before the first picture: a broker's final no to a stream, or a surface that cannot be used, or
/// nothing new for --wait. Not
/// thread-safe.
class Patience {
 public:
  /// streams: for each of the sources given below, which of options.scene.streams it is. The options must outlive it.
  Patience(const ClientOptions& options, std::vector<std::size_t> streams);

  /// has_begun: a refusal ends nothing any more. Asks a broker that refuses a stream for its reason, which takes up to
  /// 3 s, three times at most.
  bool is_over(std::span<PoseSource* const> sources, bool has_begun, TimeUs now_us);
  /// Once it is over: which stream does not come, and why.
  std::string reason(std::span<PoseSource* const> sources) const;

 private:
  bool is_final_no(std::size_t source) const;

  const ClientOptions& options_;
  std::vector<std::size_t> streams_;
  std::vector<int> asked_;              ///< For each: so often, whether a refusal is final.
  std::uint64_t bytes_ = 0;             ///< Of surfaces, so far.
  TimeUs news_us_ = 0;                  ///< When the last of them came.
  std::optional<std::size_t> refused_;  ///< A source, for good.
};

}  // namespace eigencast
