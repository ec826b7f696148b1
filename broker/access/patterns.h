// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"

namespace eigencast::broker {

/// A set of stream names, written as patterns over their segments: `*` within a segment stands for any characters of
/// it (`camera-*`), the segment `**` for any number of whole segments, none included. `lab/**` matches `lab` and
/// everything below, `*/left` matches `a/left` but not `a/b/left`. A pattern takes time in proportion to its length
/// times the name's: there is no way to make it slow.
class StreamPatterns {
 public:
  static constexpr std::size_t kMaxPatterns = 256;
  static constexpr std::size_t kMaxBytes = 128;

  StreamPatterns() = default;
  /// Errors: kInvalidArgument: what no stream name could match (an empty segment, a character that names do not have),
  /// too long, too many.
  static Result<StreamPatterns> from(std::span<const std::string> patterns);

  bool matches(std::string_view stream) const;
  bool empty() const { return !patterns_; }
  const std::vector<std::string>& texts() const;
  bool operator==(const StreamPatterns& other) const { return texts() == other.texts(); }

 private:
  std::shared_ptr<const std::vector<std::string>> patterns_;  ///< Null: none. All connections of a token share them.
};

/// What its holder may do.
struct Rights {
  StreamPatterns publish;
  StreamPatterns subscribe;
  bool admin = false;
  bool operator==(const Rights&) const = default;
};

}  // namespace eigencast::broker
