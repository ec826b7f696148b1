// SPDX-License-Identifier: MIT
#include "broker/access/patterns.h"

#include <algorithm>
#include <functional>

#include "common/core/text.h"

namespace eigencast::broker {
namespace {

/// Matches `text` item by item; a star item of the pattern stands for any number of items.
template <typename Pattern, typename Text, typename IsStar, typename Matches>
bool wildcard_matches(const Pattern& pattern, const Text& text, IsStar is_star, Matches matches) {
  std::vector<bool> reached(text.size() + 1);  // Prefixes of the text that match the pattern so far.
  reached[0] = true;
  for (const auto& item : pattern) {
    if (is_star(item)) {
      for (std::size_t i = 1; i <= text.size(); ++i) reached[i] = reached[i] || reached[i - 1];
    } else {
      for (std::size_t i = text.size(); i > 0; --i) reached[i] = reached[i - 1] && matches(item, text[i - 1]);
      reached[0] = false;
    }
  }
  return reached.back();
}

bool segment_matches(std::string_view pattern, std::string_view text) {
  return wildcard_matches(
      pattern, text, [](char c) { return c == '*'; }, std::equal_to());
}

bool name_matches(std::string_view pattern, std::string_view name) {
  return wildcard_matches(
      split(pattern, '/'), split(name, '/'), [](std::string_view item) { return item == "**"; }, segment_matches);
}

Result<void> check_pattern(const std::string& pattern) {
  const auto wrong = [&](const char* why) {
    return fail(ErrorCode::kInvalidArgument, "'" + pattern.substr(0, StreamPatterns::kMaxBytes) +
                                                 "' is not a pattern of stream names: " + why +
                                                 "; write something like lab/**, */left or camera-*");
  };
  if (pattern.size() > StreamPatterns::kMaxBytes) return wrong("it is longer than 128 bytes");
  for (const std::string_view segment : split(pattern, '/')) {
    if (segment.empty()) return wrong("a segment is empty");
    if (segment == "." || segment == "..") return wrong("no stream has a segment '.' or '..'");
    constexpr std::string_view kAllowed = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-*";
    if (segment.find_first_not_of(kAllowed) != std::string_view::npos) {
      return wrong("names are made of letters, digits, '.', '_' and '-'");
    }
    if (segment != "**" && segment.find("**") != std::string_view::npos) return wrong("'**' must be a whole segment");
  }
  return {};
}

}  // namespace

Result<StreamPatterns> StreamPatterns::from(std::span<const std::string> patterns) {
  if (patterns.size() > kMaxPatterns) {
    return fail(ErrorCode::kInvalidArgument, std::to_string(patterns.size()) + " stream patterns are too many: 256");
  }
  for (const std::string& pattern : patterns) {
    if (auto good = check_pattern(pattern); !good) return good.error();
  }
  StreamPatterns made;
  if (!patterns.empty())
    made.patterns_ = std::make_shared<const std::vector<std::string>>(patterns.begin(), patterns.end());
  return made;
}

const std::vector<std::string>& StreamPatterns::texts() const {
  static const std::vector<std::string> kNone;
  return patterns_ ? *patterns_ : kNone;
}

bool StreamPatterns::matches(std::string_view stream) const {
  return std::any_of(texts().begin(), texts().end(),
                     [&](const std::string& pattern) { return pattern == "**" || name_matches(pattern, stream); });
}

}  // namespace eigencast::broker
