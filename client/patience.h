// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// When to give up before the first picture: a broker's final no, or nothing new for --wait. Not thread-safe.
class Patience {
 public:
  /// The options must outlive it.
  explicit Patience(const ClientOptions& options) : options_(options) {}

  /// sources: one for each of options.scene.streams. Asks a broker that refuses for its reason, which takes up to 3 s,
  /// three times at most.
  bool is_over(std::span<PoseSource* const> sources, bool has_poses, TimeUs now_us);
  /// What happened to the stream, once it is over. detail: what its source says.
  std::string fate_of(const std::string& stream, const std::string& detail) const;

 private:
  bool is_final_no() const;

  const ClientOptions& options_;
  std::uint64_t bytes_ = 0;  ///< Of surfaces, so far.
  TimeUs news_us_ = 0;       ///< When the last of them came.
  int asked_ = 0;            ///< Whether a refusal is final: so often.
  bool is_refused_ = false;  ///< For good.
};

}  // namespace eigencast
