// SPDX-License-Identifier: MIT
#include "broker/access/patterns.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace eigencast::broker {
namespace {

bool matches(const std::string& pattern, const std::string& name) {
  const auto made = StreamPatterns::from(std::vector<std::string>{pattern});
  EXPECT_TRUE(made) << pattern;
  return made && made->matches(name);
}

TEST(StreamPatternsTest, StarMatchesWithinSegmentDoubleStarAcross) {
  EXPECT_TRUE(matches("lab/horse", "lab/horse"));
  EXPECT_FALSE(matches("lab/horse", "lab/horses"));
  EXPECT_FALSE(matches("lab", "lab/horse"));
  EXPECT_TRUE(matches("*", "lab"));
  EXPECT_FALSE(matches("*", "lab/horse"));
  EXPECT_TRUE(matches("camera-*", "camera-"));
  EXPECT_TRUE(matches("camera-*-left", "camera-1-left-left"));
  EXPECT_FALSE(matches("camera-*", "camera-1/x"));
  EXPECT_TRUE(matches("*/left", "a/left"));
  EXPECT_FALSE(matches("*/left", "a/b/left"));
  EXPECT_TRUE(matches("**", "a"));
  EXPECT_TRUE(matches("**", "a/b/c"));
  EXPECT_TRUE(matches("lab/**", "lab"));
  EXPECT_TRUE(matches("lab/**", "lab/a/b"));
  EXPECT_FALSE(matches("lab/**", "laboratory"));
  EXPECT_FALSE(matches("lab/**", "other/lab/a"));
  EXPECT_TRUE(matches("**/left", "left"));
  EXPECT_TRUE(matches("**/left", "a/b/left"));
  EXPECT_TRUE(matches("a/**/b/**/c", "a/x/b/b/y/c"));
  EXPECT_TRUE(matches("a/**/b/**/c", "a/b/c"));
  EXPECT_FALSE(matches("a/**/b/**/c", "a/c/b"));
}

TEST(StreamPatternsTest, EmptySetMatchesNothing) {
  EXPECT_FALSE(StreamPatterns().matches("a"));
}

TEST(StreamPatternsTest, ImpossiblePatternsAreRefused) {
  for (const char* bad :
       {"", "/", "/a", "a/", "a//b", "a b", "..", "a/../b", ".", "a**", "**a", "***", "a?", "{a,b}", "\xc3\xa4"}) {
    const auto made = StreamPatterns::from(std::vector<std::string>{bad});
    EXPECT_FALSE(made) << bad;
  }
  EXPECT_FALSE(StreamPatterns::from(std::vector<std::string>{std::string(129, 'a')}));
  EXPECT_FALSE(StreamPatterns::from(std::vector<std::string>(257, "a")));
}

/// The definition, by trying everything: exponential, and so only for short names.
bool matches_by_definition(const std::vector<std::string>& pattern, const std::vector<std::string>& name, std::size_t p,
                           std::size_t n) {
  if (p == pattern.size()) return n == name.size();
  if (pattern[p] == "**") {
    for (std::size_t skip = n; skip <= name.size(); ++skip) {
      if (matches_by_definition(pattern, name, p + 1, skip)) return true;
    }
    return false;
  }
  return n < name.size() && (pattern[p] == "*" || pattern[p] == name[n]) &&
         matches_by_definition(pattern, name, p + 1, n + 1);
}

std::string joined(const std::vector<std::string>& segments) {
  std::string text;
  for (const auto& segment : segments) text += (text.empty() ? "" : "/") + segment;
  return text;
}

TEST(StreamPatternsTest, AgreesWithTheDefinitionOnAllShortPatterns) {
  const std::vector<std::string> alphabet = {"a", "b", "*", "**"};
  for (int size = 1; size <= 4; ++size) {
    for (int code = 0; code < 1 << (2 * size); ++code) {
      std::vector<std::string> pattern;
      for (int i = 0; i < size; ++i) pattern.push_back(alphabet[static_cast<std::size_t>((code >> (2 * i)) & 3)]);
      const auto made = StreamPatterns::from(std::vector<std::string>{joined(pattern)});
      ASSERT_TRUE(made);
      for (int length = 1; length <= 4; ++length) {
        for (int bits = 0; bits < 1 << length; ++bits) {
          std::vector<std::string> name;
          for (int i = 0; i < length; ++i) name.push_back((bits >> i & 1) != 0 ? "b" : "a");
          EXPECT_EQ(made->matches(joined(name)), matches_by_definition(pattern, name, 0, 0))
              << joined(pattern) << " and " << joined(name);
        }
      }
    }
  }
}

}  // namespace
}  // namespace eigencast::broker
