// SPDX-License-Identifier: MIT
#include "tools/igtl/messages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <utility>

namespace eigencast::igtl {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

/// Numbers as big-endian bytes.
Bytes words(const std::vector<std::uint32_t>& values) {
  Bytes bytes;
  for (const std::uint32_t v : values)
    for (int shift = 24; shift >= 0; shift -= 8) bytes.push_back(static_cast<std::uint8_t>(v >> shift));
  return bytes;
}

PolyData square() {
  return {{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0.5F},
          {0, 1, 2, 1, 3, 2},
          {},
          {{"heat", {1, 2, 3, 4}}, {"odd name", {5, 6, 7, 8}}}};
}

Bytes body_of(const Bytes& message) {
  return {message.begin() + kHeaderBytes, message.end()};
}

Header header_of(const Bytes& message) {
  return *header_from_bytes(ByteView(message).first<kHeaderBytes>());
}

/// Four points, then what follows in its header after their number, cells and attributes.
Bytes content_with(std::vector<std::uint32_t> sizes, const std::vector<std::uint32_t>& rest) {
  std::vector<std::uint32_t> all{4};
  sizes.resize(9);
  all.insert(all.end(), sizes.begin(), sizes.end());
  all.resize(all.size() + 12);
  all.insert(all.end(), rest.begin(), rest.end());
  return words(all);
}

/// Bit by bit.
std::uint64_t checksum(ByteView bytes) {
  std::uint64_t crc = 0;
  for (const std::uint8_t byte : bytes) {
    crc ^= std::uint64_t{byte} << 56;
    for (int bit = 0; bit < 8; ++bit) crc = crc << 1 ^ (crc >> 63 != 0 ? 0x42F0E1EBA9EA3693 : 0);
  }
  return crc;
}

TEST(IgtlMessages, BothHeadersComeBackWhole) {
  for (const int version : {1, 2}) {
    const Bytes message = message_from_polydata(square(), "A device of 20 bytes", version, 0x1234500000000);
    const Header header = header_of(message);
    EXPECT_EQ(header.version, version);
    EXPECT_EQ(header.type, "POLYDATA");
    EXPECT_EQ(header.device, "A device of 20 bytes");
    EXPECT_EQ(header.timestamp, 0x1234500000000U);
    EXPECT_EQ(header.body_bytes, message.size() - kHeaderBytes);
    const Bytes body = body_of(message);
    const auto content = content_from_body(header, body);
    ASSERT_TRUE(content) << content.error().message;
    const auto data = polydata_from_content(*content);
    ASSERT_TRUE(data) << data.error().message;
    EXPECT_EQ(data->points, square().points);
    EXPECT_EQ(data->corners, square().corners);
    EXPECT_THAT(data->offsets, IsEmpty());
    ASSERT_EQ(data->scalars.size(), 2U);
    EXPECT_EQ(data->scalars[1].name, "odd name");
    EXPECT_THAT(data->scalars[1].values, ElementsAre(5, 6, 7, 8));
  }
}

TEST(IgtlMessages, TheChecksumIsEcma182) {
  // "123456789" has the check value 6c40df5f0b497347 in catalogues of cyclic redundancy checks.
  const Bytes digits{'1', '2', '3', '4', '5', '6', '7', '8', '9'};
  Header header;
  header.crc = 0x6c40df5f0b497347;
  EXPECT_TRUE(content_from_body(header, digits));
  ++header.crc;
  EXPECT_EQ(content_from_body(header, digits).error().code, ErrorCode::kCorrupt);
}

TEST(IgtlMessages, PolygonsKeepTheirOrderAndStripsTheirSense) {
  const auto data =
      polydata_from_content(content_with({1, 8, 0, 0, 1, 20, 1, 20, 0}, {1, 3, 4, 0, 1, 3, 2, 4, 0, 1, 2, 3}));
  ASSERT_TRUE(data) << data.error().message;
  EXPECT_THAT(data->corners, ElementsAre(0, 1, 3, 2, 0, 1, 2, 2, 1, 3));
  EXPECT_THAT(data->offsets, ElementsAre(0, 4, 7, 10));
}

TEST(IgtlMessages, SizesThatDoNotFitAreRefused) {
  const std::uint32_t huge = 0xffffffff;
  const std::vector<std::pair<const char*, Bytes>> hostile{
      {"points", words({huge, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3})},
      {"no points", words({0, 0, 0, 0, 0, 0, 0, 0, 0, 0})},
      {"polygons' size", content_with({0, 0, 0, 0, 1, huge}, {3, 0, 1, 2})},
      {"number of polygons", content_with({0, 0, 0, 0, huge, 16}, {3, 0, 1, 2})},
      {"corners of a polygon", content_with({0, 0, 0, 0, 1, 16}, {huge, 0, 1, 2})},
      {"a point that is not there", content_with({0, 0, 0, 0, 1, 16}, {3, 0, 1, 4})},
      {"a size of more cells", content_with({0, 0, 0, 0, 1, 20}, {3, 0, 1, 2, 0})},
      {"lines' size", content_with({0, 0, 1, huge}, {})},
      {"attributes", content_with({0, 0, 0, 0, 0, 0, 0, 0, huge}, {})},
      {"values of an attribute", content_with({0, 0, 0, 0, 0, 0, 0, 0, 1}, {0x00ffffff, 0xffff6100, 0})},
      {"a name without end", content_with({0, 0, 0, 0, 0, 0, 0, 0, 1}, {0x00010000, 0x00046161, 0x61616161})},
  };
  for (const auto& [what, content] : hostile) {
    const auto data = polydata_from_content(content);
    ASSERT_FALSE(data) << what;
    EXPECT_EQ(data.error().code, ErrorCode::kCorrupt) << what;
  }
}

TEST(IgtlMessages, NoPartOfAMessageAndNoChangedByteIsTakenWrongly) {
  const Bytes body = body_of(message_from_polydata(square(), "d", 1, 0));
  for (std::size_t size = 0; size < body.size(); ++size)
    EXPECT_FALSE(polydata_from_content(ByteView(body).first(size))) << size;
  for (std::size_t at = 0; at < body.size(); ++at) {
    Bytes changed = body;
    changed[at] ^= 0xff;
    if (const auto data = polydata_from_content(changed)) {
      const std::size_t points = data->points.size() / 3;
      EXPECT_TRUE(std::all_of(data->corners.begin(), data->corners.end(), [&](auto c) { return c < points; })) << at;
      for (const auto& scalar : data->scalars) EXPECT_EQ(scalar.values.size(), points) << at;
    }
  }
}

TEST(IgtlMessages, ExtendedHeadersLongerThanTheMessageAreRefused) {
  for (const Bytes& body :
       {Bytes{0, 12, 0, 0}, Bytes{0, 11, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0}, Bytes{0, 13, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0},
        Bytes{0, 12, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0}, Bytes{0, 12, 0, 0, 255, 255, 255, 255, 0, 0, 0, 0}}) {
    Header header;
    header.crc = checksum(body);
    EXPECT_TRUE(content_from_body(header, body)) << "its checksum is right";
    header.version = 2;
    EXPECT_FALSE(content_from_body(header, body));
  }
}

TEST(IgtlMessages, AReaderCutsBytesWhereverTheyBreak) {
  const Bytes first = message_from_polydata(square(), "one", 1, 0), last = message_from_polydata(square(), "two", 2, 0);
  Bytes other = first;
  other[2] = 'I';  // another type, passed over
  Bytes all = first;
  all.insert(all.end(), other.begin(), other.end());
  all.insert(all.end(), last.begin(), last.end());
  for (const std::size_t step : {std::size_t{1}, std::size_t{7}, std::size_t{57}, std::size_t{58}, all.size()}) {
    MessageReader reader;
    std::vector<std::string> devices;
    for (std::size_t at = 0; at < all.size(); at += step) {
      const auto part = ByteView(all).subspan(at, std::min(step, all.size() - at));
      ASSERT_TRUE(reader.take(part, [&](const Header& header, ByteView body) {
        devices.push_back(header.device);
        EXPECT_TRUE(content_from_body(header, body));
      }));
    }
    EXPECT_THAT(devices, ElementsAre("one", "two"));
  }
}

TEST(IgtlMessages, AnnouncedBytesAreCappedAndVersionsChecked) {
  Bytes head = message_from_polydata(square(), "d", 1, 0);
  head.resize(kHeaderBytes);
  const auto refused_as = [&](std::size_t at, std::uint8_t value) {
    Bytes changed = head;
    changed[at] = value;
    const auto header = header_from_bytes(ByteView(changed).first<kHeaderBytes>());
    return header ? ErrorCode::kInternal : header.error().code;
  };
  EXPECT_EQ(refused_as(42, 1), ErrorCode::kTooLarge);
  EXPECT_EQ(refused_as(46, 4), ErrorCode::kTooLarge);
  EXPECT_EQ(refused_as(1, 3), ErrorCode::kUnsupported);
  EXPECT_EQ(refused_as(0, 'G'), ErrorCode::kUnsupported);
}

}  // namespace
}  // namespace eigencast::igtl
