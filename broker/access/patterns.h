// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"

namespace eigencast::broker {

/// Patterns of stream names: `*` matches any characters within a segment (`camera-*`), the segment `**` any number of
/// segments, also none. Matching takes time in proportion to pattern length times name length.
class StreamPatterns {
 public:
  static constexpr std::size_t kMaxPatterns = 256;
  static constexpr std::size_t kMaxBytes = 128;

  StreamPatterns() = default;
  /// Errors: kInvalidArgument (a pattern that no stream name can match, too long, too many).
  static Result<StreamPatterns> from(std::span<const std::string> patterns);

  bool matches(std::string_view stream) const;
  bool empty() const { return !patterns_; }
  const std::vector<std::string>& texts() const;
  bool operator==(const StreamPatterns& other) const { return texts() == other.texts(); }

 private:
  std::shared_ptr<const std::vector<std::string>> patterns_;  ///< Null: none. All connections of a token share them.
};

struct Rights {
  StreamPatterns publish;
  StreamPatterns subscribe;
  bool admin = false;
  StreamPatterns speak;   ///< In rooms, which `subscribe` lets watch.
  StreamPatterns rewind;  ///< Of streams, likewise.
  bool operator==(const Rights&) const = default;
};

}  // namespace eigencast::broker
