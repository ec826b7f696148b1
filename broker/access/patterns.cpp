// SPDX-License-Identifier: MIT
#include "broker/access/patterns.h"

#include <algorithm>

namespace eigencast::broker {
namespace {

std::string_view segment_at(std::string_view text, std::size_t at) {
  return text.substr(at, text.find('/', at) - at);
}

/// Where the next segment begins; past the end after the last one.
std::size_t next_of(std::string_view text, std::size_t at) {
  return at + segment_at(text, at).size() + 1;
}

// Both levels use the same rule: after a star, the shortest match that works; only the latest star needs to be tried
// again, because whatever an earlier one could take on the latest one can as well.

bool segment_matches(std::string_view pattern, std::string_view text) {
  std::size_t p = 0;
  std::size_t t = 0;
  std::size_t star = std::string_view::npos;
  std::size_t star_text = 0;
  while (t < text.size()) {
    if (p < pattern.size() && pattern[p] == '*') {
      star = p++;
      star_text = t;
    } else if (p < pattern.size() && pattern[p] == text[t]) {
      ++p;
      ++t;
    } else if (star != std::string_view::npos) {
      p = star + 1;
      t = ++star_text;
    } else {
      return false;
    }
  }
  while (p < pattern.size() && pattern[p] == '*') ++p;
  return p == pattern.size();
}

bool name_matches(std::string_view pattern, std::string_view name) {
  std::size_t p = 0;
  std::size_t n = 0;
  std::size_t star = std::string_view::npos;
  std::size_t star_name = 0;
  while (n <= name.size()) {
    const bool left = p <= pattern.size();
    if (left && segment_at(pattern, p) == "**") {
      star = p;
      star_name = n;
      p = next_of(pattern, p);
    } else if (left && segment_matches(segment_at(pattern, p), segment_at(name, n))) {
      p = next_of(pattern, p);
      n = next_of(name, n);
    } else if (star != std::string_view::npos) {
      p = next_of(pattern, star);
      n = star_name = next_of(name, star_name);
    } else {
      return false;
    }
  }
  while (p <= pattern.size() && segment_at(pattern, p) == "**") p = next_of(pattern, p);
  return p > pattern.size();
}

bool is_pattern_character(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' ||
         c == '-' || c == '*';
}

Result<void> check(const std::string& pattern) {
  const auto wrong = [&](const char* why) {
    return fail(ErrorCode::kInvalidArgument, "'" + pattern.substr(0, StreamPatterns::kMaxBytes) +
                                                 "' is no pattern of stream names: " + why +
                                                 "; write something like lab/**, */left or camera-*");
  };
  if (pattern.size() > StreamPatterns::kMaxBytes) return wrong("it is longer than 128 bytes");
  for (std::size_t at = 0; at <= pattern.size(); at = next_of(pattern, at)) {
    const std::string_view segment = segment_at(pattern, at);
    if (segment.empty()) return wrong("a segment is empty");
    if (segment == "." || segment == "..") return wrong("no stream has a segment '.' or '..'");
    if (!std::all_of(segment.begin(), segment.end(), is_pattern_character)) {
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
    if (auto good = check(pattern); !good) return good.error();
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
                     [&](const std::string& pattern) { return name_matches(pattern, stream); });
}

}  // namespace eigencast::broker
