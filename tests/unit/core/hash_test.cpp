// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include "common/core/hash/sha256.h"

namespace eigencast {
namespace {

ByteView byte_view(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

// Known answers of FIPS 180-2, appendix B.
TEST(Sha256, KnownAnswers) {
  EXPECT_EQ(sha256(byte_view("")).hex(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(sha256(byte_view("abc")).hex(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Sha256, PartsGiveTheDigestOfTheWhole) {
  Sha256Stream stream;
  stream.update(byte_view("a"));
  stream.update(byte_view(""));
  stream.update(byte_view("bc"));
  EXPECT_EQ(stream.finish(), sha256(byte_view("abc")));
}

TEST(Sha256, HexRoundTripsAndOtherTextIsRefused) {
  const Sha256 id = sha256(byte_view("x"));
  EXPECT_EQ(Sha256::from_hex(id.hex()), id);
  EXPECT_FALSE(Sha256::from_hex(""));
  EXPECT_FALSE(Sha256::from_hex(std::string(63, 'a')));
  EXPECT_FALSE(Sha256::from_hex(std::string(64, 'A')));
  EXPECT_FALSE(Sha256::from_hex(std::string(64, '/')));
}

}  // namespace
}  // namespace eigencast
