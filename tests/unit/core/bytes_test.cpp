// SPDX-License-Identifier: MIT
#include "common/core/bytes.h"

#include <gtest/gtest.h>

#include <limits>

namespace eigencast {
namespace {

TEST(Bytes, EveryTypeRoundTrips) {
  Bytes out;
  ByteWriter w(out);
  w.u8(0xab);
  w.u16(0x1234);
  w.u32(0xdeadbeef);
  w.u64(0x0123456789abcdef);
  w.f32(-1.5f);
  w.f64(1e300);
  ByteReader r(out);
  EXPECT_EQ(r.u8(), 0xab);
  EXPECT_EQ(r.u16(), 0x1234);
  EXPECT_EQ(r.u32(), 0xdeadbeefu);
  EXPECT_EQ(r.u64(), 0x0123456789abcdefu);
  EXPECT_EQ(r.f32(), -1.5f);
  EXPECT_EQ(r.f64(), 1e300);
  EXPECT_TRUE(r.finished());
}

TEST(Bytes, IntegersAreLittleEndian) {
  Bytes out;
  ByteWriter(out).u32(0x04030201);
  EXPECT_EQ(out, (Bytes{1, 2, 3, 4}));
}

TEST(Bytes, VarintsRoundTripAtEveryLength) {
  for (unsigned bits = 0; bits < 64; ++bits) {
    for (const std::uint64_t v : {std::uint64_t{1} << bits, (std::uint64_t{1} << bits) - 1}) {
      Bytes out;
      ByteWriter(out).varint(v);
      ByteReader r(out);
      EXPECT_EQ(r.varint(), v);
      EXPECT_TRUE(r.finished());
    }
  }
  Bytes out;
  ByteWriter(out).varint(std::numeric_limits<std::uint64_t>::max());
  EXPECT_EQ(out.size(), 10u);
  ByteReader r(out);
  EXPECT_EQ(r.varint(), std::numeric_limits<std::uint64_t>::max());
}

TEST(Bytes, OverlongVarintsFail) {
  for (const Bytes& bad : {Bytes(11, 0xff), Bytes{0x80, 0x00},
                           Bytes{0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x02}, Bytes{0x80}, Bytes{}}) {
    ByteReader r(bad);
    r.varint();
    EXPECT_TRUE(r.failed());
  }
}

TEST(Bytes, ReadPastTheEndStaysFailed) {
  const Bytes in{1, 2, 3};
  ByteReader r(in);
  EXPECT_EQ(r.u32(), 0u);
  EXPECT_TRUE(r.failed());
  EXPECT_EQ(r.u8(), 0u);
  EXPECT_EQ(r.remaining(), 0u);
  EXPECT_FALSE(r.finished());
}

TEST(Bytes, RequestBeyondTheEndGivesNothing) {
  const Bytes in{1, 2, 3};
  ByteReader r(in);
  EXPECT_TRUE(r.bytes(std::numeric_limits<std::size_t>::max()).empty());
  EXPECT_TRUE(r.failed());
}

}  // namespace
}  // namespace eigencast
