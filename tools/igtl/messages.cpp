// SPDX-License-Identifier: MIT
#include "tools/igtl/messages.h"

#include <algorithm>
#include <array>
#include <bit>
#include <string_view>
#include <utility>

namespace eigencast::igtl {
namespace {

constexpr std::size_t kTypeBytes = 12;
constexpr std::size_t kExtendedHeaderBytes = 12;
constexpr std::size_t kMaxAttributes = 64;
constexpr std::size_t kMaxAttributeName = 255;
constexpr std::uint8_t kPointScalar = 0;

/// ECMA-182, from the highest bit on, from 0.
std::uint64_t crc64(ByteView bytes) {
  static const auto table = [] {
    std::array<std::uint64_t, 256> made{};
    for (std::uint64_t i = 0; i < made.size(); ++i) {
      std::uint64_t x = i << 56;
      for (int bit = 0; bit < 8; ++bit) x = x << 1 ^ (x >> 63 != 0 ? 0x42F0E1EBA9EA3693 : 0);
      made[i] = x;
    }
    return made;
  }();
  std::uint64_t crc = 0;
  for (const std::uint8_t byte : bytes) crc = table[(crc >> 56 ^ byte) & 255] ^ crc << 8;
  return crc;
}

/// Big-endian values; as ByteReader on hostile input.
class NetworkReader {
 public:
  explicit NetworkReader(ByteView in) : in_(in) {}

  std::uint8_t u8() { return static_cast<std::uint8_t>(number(1)); }
  std::uint16_t u16() { return static_cast<std::uint16_t>(number(2)); }
  std::uint32_t u32() { return static_cast<std::uint32_t>(number(4)); }
  std::uint64_t u64() { return number(8); }
  /// Up to its end, or to the first zero within.
  std::string text(std::size_t bytes) {
    const ByteView field = view(bytes);
    return {field.begin(), std::find(field.begin(), field.end(), 0)};
  }
  ByteView view(std::uint64_t bytes) {
    if (bytes > in_.size()) return fail_here();
    const ByteView taken = in_.first(bytes);
    in_ = in_.subspan(bytes);
    return taken;
  }
  /// REQUIRES: count * 4 does not overflow.
  std::vector<float> floats(std::uint64_t count) {
    NetworkReader values(view(4 * count));
    std::vector<float> out(values.remaining() / 4);
    for (float& x : out) x = std::bit_cast<float>(values.u32());
    return out;
  }
  /// A text that ends with a zero; without one it fails.
  std::string terminated(std::size_t max_bytes) {
    const auto window = in_.first(std::min(in_.size(), max_bytes + 1));
    const auto end = std::find(window.begin(), window.end(), 0);
    if (end == window.end()) return fail_here(), std::string();
    std::string made(window.begin(), end);
    in_ = in_.subspan(made.size() + 1);
    return made;
  }
  std::size_t remaining() const { return in_.size(); }
  bool failed() const { return failed_; }

 private:
  ByteView fail_here() {
    failed_ = true;
    return in_ = {};
  }
  std::uint64_t number(std::size_t bytes) {
    std::uint64_t value = 0;
    for (const std::uint8_t byte : view(bytes)) value = value << 8 | byte;
    return value;
  }
  ByteView in_;
  bool failed_ = false;
};

class NetworkWriter {
 public:
  explicit NetworkWriter(Bytes& out) : out_(out) {}

  void u8(std::uint8_t v) { out_.push_back(v); }
  void u16(std::uint16_t v) { number(v, 2); }
  void u32(std::uint32_t v) { number(v, 4); }
  void u64(std::uint64_t v) { number(v, 8); }
  void floats(std::span<const float> values) {
    for (const float x : values) u32(std::bit_cast<std::uint32_t>(x));
  }
  /// Filled up with zeros, cut where it is longer.
  void text(std::string_view text, std::size_t bytes) {
    for (std::size_t i = 0; i < bytes; ++i) out_.push_back(i < text.size() ? static_cast<std::uint8_t>(text[i]) : 0);
  }

 private:
  void number(std::uint64_t v, int bytes) {
    for (int i = bytes - 1; i >= 0; --i) out_.push_back(static_cast<std::uint8_t>(v >> (8 * i)));
  }
  Bytes& out_;
};

Error corrupt(const std::string& what) {
  return fail(ErrorCode::kCorrupt, "POLYDATA: " + what);
}

/// Cells as numbers of points, each after how many it has. `each` gets those of one.
template <typename Each>
Result<void> read_cells(ByteView bytes, std::uint32_t cells, std::size_t points, const char* what, const Each& each) {
  NetworkReader in(bytes);
  std::vector<std::uint32_t> cell;
  for (std::uint32_t i = 0; i < cells; ++i) {
    const std::uint64_t corners = in.u32();
    if (in.failed() || corners > in.remaining() / 4)
      return corrupt(std::string(what) + " end within cell " + std::to_string(i));
    cell.resize(corners);
    for (std::uint32_t& corner : cell) {
      corner = in.u32();
      if (corner >= points)
        return corrupt("cell " + std::to_string(i) + " of the " + what + " has point " + std::to_string(corner) +
                       " of " + std::to_string(points));
    }
    each(cell);
  }
  if (in.remaining() != 0) return corrupt(std::string(what) + " are shorter than their size says");
  return {};
}

Result<void> read_scalars(NetworkReader& in, std::uint32_t attributes, std::size_t points, PolyData& data) {
  struct Attribute {
    std::uint8_t type = 0, components = 0;
    std::uint32_t tuples = 0;
    std::string name;
  };
  if (attributes > kMaxAttributes)
    return corrupt(std::to_string(attributes) + " attributes; at most " + std::to_string(kMaxAttributes) + " are read");
  std::vector<Attribute> all(attributes);
  for (Attribute& one : all) {
    one.type = in.u8();
    one.components = in.u8();
    one.tuples = in.u32();
  }
  std::size_t name_bytes = 0;
  for (Attribute& one : all) {
    one.name = in.terminated(kMaxAttributeName);
    name_bytes += one.name.size() + 1;
  }
  if (name_bytes % 2 != 0) (void)in.u8();
  for (Attribute& one : all) {
    const bool taken = one.type == kPointScalar && one.components == 1 && one.tuples == points && !one.name.empty() &&
                       data.scalars.size() < kMaxScalars &&
                       std::none_of(data.scalars.begin(), data.scalars.end(),
                                    [&](const PolyData::Scalar& other) { return other.name == one.name; });
    const std::uint64_t values = std::uint64_t{one.components} * one.tuples;
    if (taken)
      data.scalars.push_back({std::move(one.name), in.floats(values)});
    else
      (void)in.view(4 * values);
  }
  return in.failed() ? Result<void>(corrupt("attributes end early")) : Result<void>();
}

}  // namespace

Result<Header> header_from_bytes(std::span<const std::uint8_t, kHeaderBytes> bytes) {
  NetworkReader in(bytes);
  Header header;
  header.version = in.u16();
  header.type = in.text(kTypeBytes);
  header.device = in.text(kMaxNameBytes);
  header.timestamp = in.u64();
  header.body_bytes = in.u64();
  header.crc = in.u64();
  if (header.version != 1 && header.version != 2)
    return fail(ErrorCode::kUnsupported, "a header of version " + std::to_string(header.version) +
                                             " is not one of OpenIGTLink's 1 and 2: does the peer speak OpenIGTLink?");
  if (header.type == "POLYDATA" && header.body_bytes > kMaxBodyBytes)
    return fail(ErrorCode::kTooLarge, "a POLYDATA of " + std::to_string(header.body_bytes) + " bytes; at most " +
                                          std::to_string(kMaxBodyBytes) + " are read: send a coarser surface");
  return header;
}

Result<ByteView> content_from_body(const Header& header, ByteView body) {
  if (crc64(body) != header.crc) return corrupt("its checksum is another: it was damaged, or its sender makes none");
  if (header.version == 1) return body;
  NetworkReader in(body);
  const std::uint64_t extended = in.u16(), meta = std::uint64_t{in.u16()} + in.u32();
  if (body.size() < kExtendedHeaderBytes || extended < kExtendedHeaderBytes || extended + meta > body.size())
    return corrupt("extended header and meta data are longer than the message");
  return body.subspan(extended, body.size() - extended - meta);
}

Result<PolyData> polydata_from_content(ByteView content) {
  NetworkReader in(content);
  struct Cells {
    const char* what;
    std::uint32_t cells = 0, bytes = 0;
  };
  const std::uint64_t points = in.u32();
  std::array<Cells, 4> kinds{{{"vertices"}, {"lines"}, {"polygons"}, {"triangle strips"}}};
  for (Cells& kind : kinds) {
    kind.cells = in.u32();
    kind.bytes = in.u32();
  }
  const std::uint32_t attributes = in.u32();
  if (in.failed()) return corrupt("shorter than its header");
  if (points == 0) return corrupt("no points");
  if (points > in.remaining() / 12) return corrupt(std::to_string(points) + " points do not fit into the message");
  PolyData data;
  data.points = in.floats(3 * points);

  std::vector<std::uint32_t> triangles;
  data.offsets.push_back(0);
  for (const Cells& kind : kinds) {
    const ByteView bytes = in.view(kind.bytes);
    if (in.failed()) return corrupt(std::string(kind.what) + " do not fit into the message");
    const bool polygons = &kind == &kinds[2], strips = &kind == &kinds[3];
    if (!polygons && !strips) continue;
    const auto add = [&](std::span<const std::uint32_t> cell) {
      data.corners.insert(data.corners.end(), cell.begin(), cell.end());
      data.offsets.push_back(data.corners.size());
    };
    const auto cut = [&](const std::vector<std::uint32_t>& strip) {
      for (std::size_t i = 2; i < strip.size(); ++i) {
        const bool turned = i % 2 != 0;  // every second one has the other sense
        const std::array<std::uint32_t, 3> triangle{strip[i - (turned ? 1 : 2)], strip[i - (turned ? 2 : 1)], strip[i]};
        add(triangle);
      }
    };
    const auto read = polygons ? read_cells(bytes, kind.cells, points, kind.what, add)
                               : read_cells(bytes, kind.cells, points, kind.what, cut);
    if (!read) return read.error();
  }
  if (const auto read = read_scalars(in, attributes, points, data); !read) return read.error();
  const bool only_triangles = [&] {
    for (std::size_t i = 0; i < data.offsets.size(); ++i)
      if (data.offsets[i] != 3 * i) return false;
    return true;
  }();
  if (only_triangles) data.offsets.clear();
  return data;
}

Bytes message_from_polydata(const PolyData& data, const std::string& device, int version, std::uint64_t timestamp) {
  const std::size_t points = data.points.size() / 3, triangles = data.corners.size() / 3;
  Bytes body;
  NetworkWriter out(body);
  body.reserve(64 + 4 * (data.points.size() + 4 * triangles + data.scalars.size() * points));
  if (version == 2) {
    out.u16(kExtendedHeaderBytes);
    out.u16(0);  // no meta data
    out.u32(0);
    out.u32(0);  // and no number
  }
  out.u32(static_cast<std::uint32_t>(points));
  for (int i = 0; i < 4; ++i) out.u32(0);  // neither vertices nor lines
  out.u32(static_cast<std::uint32_t>(triangles));
  out.u32(static_cast<std::uint32_t>(16 * triangles));
  out.u32(0);  // no strips
  out.u32(0);
  out.u32(static_cast<std::uint32_t>(data.scalars.size()));
  out.floats(data.points);
  for (std::size_t i = 0; i < data.corners.size(); ++i) {
    if (i % 3 == 0) out.u32(3);
    out.u32(data.corners[i]);
  }
  std::size_t name_bytes = 0;
  for (const PolyData::Scalar& scalar : data.scalars) {
    out.u8(kPointScalar);
    out.u8(1);
    out.u32(static_cast<std::uint32_t>(scalar.values.size()));
  }
  for (const PolyData::Scalar& scalar : data.scalars) {
    const std::size_t length = std::min(scalar.name.size(), kMaxAttributeName) + 1;
    out.text(std::string_view(scalar.name).substr(0, length - 1), length);
    name_bytes += length;
  }
  if (name_bytes % 2 != 0) out.u8(0);
  for (const PolyData::Scalar& scalar : data.scalars) out.floats(scalar.values);

  Bytes message;
  message.reserve(kHeaderBytes + body.size());
  NetworkWriter head(message);
  head.u16(static_cast<std::uint16_t>(version));
  head.text("POLYDATA", kTypeBytes);
  head.text(device, kMaxNameBytes);
  head.u64(timestamp);
  head.u64(body.size());
  head.u64(crc64(body));
  message.insert(message.end(), body.begin(), body.end());
  return message;
}

Result<void> MessageReader::take(ByteView bytes, const OnPolyData& on_polydata) {
  while (!bytes.empty()) {
    const ByteView part = bytes.first(std::min<std::uint64_t>(bytes.size(), missing_));
    if (state_ != State::kOther) buffer_.insert(buffer_.end(), part.begin(), part.end());
    bytes = bytes.subspan(part.size());
    missing_ -= part.size();
    if (missing_ > 0) continue;
    if (state_ == State::kHeader) {
      const auto header = header_from_bytes(ByteView(buffer_).first<kHeaderBytes>());
      if (!header) return header.error();
      header_ = *header;
      buffer_.clear();
      state_ = header_.type == "POLYDATA" ? State::kPolyData : State::kOther;
      missing_ = header_.body_bytes;
      if (missing_ > 0) continue;
    }
    if (state_ == State::kPolyData) on_polydata(header_, buffer_);
    buffer_.clear();
    state_ = State::kHeader;
    missing_ = kHeaderBytes;
  }
  return {};
}

}  // namespace eigencast::igtl
