// SPDX-License-Identifier: MIT
#include "common/core/text.h"

#include <gtest/gtest.h>

namespace eigencast {
namespace {

TEST(Text, TrimmedLosesBlanksAtBothEnds) {
  EXPECT_EQ(trimmed(" \ta b\r\n"), "a b");
  EXPECT_EQ(trimmed(" \n\t"), "");
  EXPECT_EQ(trimmed(""), "");
}

TEST(Text, SplitKeepsEmptyParts) {
  using Parts = std::vector<std::string_view>;
  EXPECT_EQ(split("a,b", ','), (Parts{"a", "b"}));
  EXPECT_EQ(split(",a,,", ','), (Parts{"", "a", "", ""}));
  EXPECT_EQ(split("", ','), Parts{""});
}

TEST(Text, FormattedIsAsLongAsNeeded) {
  EXPECT_EQ(formatted("%s-%d", std::string(5000, 'x').c_str(), 7), std::string(5000, 'x') + "-7");
}

TEST(Text, EscapedHasNothingThatATerminalObeys) {
  EXPECT_EQ(escaped("plain, Gr\u00fc\u00dfe, \u4e16, \U0001f600 \\"), "plain, Gr\u00fc\u00dfe, \u4e16, \U0001f600 \\");
  EXPECT_EQ(escaped("a\x1b[31m\n\r\t\x7f"), "a\\u001b[31m\\u000a\\u000d\\u0009\\u007f");
  EXPECT_EQ(escaped(std::string_view("\0", 1)), "\\u0000");
  EXPECT_EQ(escaped("\u0080\u009b\u00a0"), "\\u0080\\u009b\u00a0");
  EXPECT_EQ(escaped("\u202e\u2028\u2066\u2069\u2027"), "\\u202e\\u2028\\u2066\\u2069\u2027");
  EXPECT_EQ(escaped("\x9b"
                    "31m \xc3\x28 \xe2\x80"),
            "\\u009b31m \\u00c3( \\u00e2\\u0080")
      << "not UTF-8";
  EXPECT_EQ(escaped("\xc0\x9b \xe0\x82\x9b"), "\\u001b \\u009b") << "longer than need be";
  EXPECT_EQ(escaped("\xff\xfe\xf8\x88\x80\x80\x80"), "\\u00ff\\u00fe\\u00f8\\u0088\\u0080\\u0080\\u0080");
  for (int byte = 0; byte < 256; ++byte) {
    for (const char c : escaped(std::string(1, static_cast<char>(byte)))) EXPECT_TRUE(c >= 0x20 && c < 0x7F) << byte;
  }
  EXPECT_EQ(escaped(escaped("\x1b")), escaped("\x1b"));
}

ByteView bytes_view(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

// RFC 4648, section 10.
TEST(Base64Test, MatchesVectorsOfRfc4648) {
  const std::pair<const char*, const char*> vectors[] = {{"", ""},
                                                         {"f", "Zg=="},
                                                         {"fo", "Zm8="},
                                                         {"foo", "Zm9v"},
                                                         {"foob", "Zm9vYg=="},
                                                         {"fooba", "Zm9vYmE="},
                                                         {"foobar", "Zm9vYmFy"}};
  for (const auto& [plain, encoded] : vectors) {
    EXPECT_EQ(base64_from_bytes(bytes_view(plain)), encoded);
    EXPECT_EQ(bytes_from_base64(encoded), Bytes(bytes_view(plain).begin(), bytes_view(plain).end())) << encoded;
  }
}

TEST(Base64Test, EveryByteRoundTripsInBothAlphabets) {
  Bytes all;
  for (int i = 0; i < 256; ++i) {
    all.push_back(static_cast<std::uint8_t>(i));
    for (const Base64 alphabet : {Base64::kStandard, Base64::kUrl}) {
      EXPECT_EQ(bytes_from_base64(base64_from_bytes(all, alphabet), alphabet), all) << i;
    }
  }
  EXPECT_EQ(base64_from_bytes(Bytes{0xfb, 0xff}, Base64::kUrl), "-_8");
  EXPECT_EQ(base64_from_bytes(Bytes{0xfb, 0xff}), "+/8=");
}

TEST(Base64Test, OtherSpellingsAreRefused) {
  for (const char* text : {"Z", "Zg", "Zg=", "Zg==\n", " Zg==", "Zh==", "Zm9=", "=", "====", "Z===", "Zm-v"}) {
    EXPECT_FALSE(bytes_from_base64(text)) << text;
  }
  for (const char* text : {"Z", "Zg==", "Zh", "Zm9", "Zm+v", "Zm9v\n"}) {
    EXPECT_FALSE(bytes_from_base64(text, Base64::kUrl)) << text;
  }
}

}  // namespace
}  // namespace eigencast
