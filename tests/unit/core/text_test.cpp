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
