// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/result.h"

/// Messages of OpenIGTLink as bytes: headers of versions 1 and 2, POLYDATA. J. Tokuda et al., "OpenIGTLink: an open
/// network protocol for image-guided therapy environment", 2009; openigtlink.org. No sockets, no clock.
namespace eigencast::igtl {

inline constexpr std::size_t kHeaderBytes = 58;
inline constexpr std::uint64_t kMaxBodyBytes = std::uint64_t{64} << 20;  ///< Of a POLYDATA message: a million vertices.
inline constexpr std::size_t kMaxScalars = 10;                           ///< As many as a stream carries.
inline constexpr std::size_t kMaxNameBytes = 20;                         ///< Of a device, without an end.

struct Header {
  int version = 1;
  std::string type, device;
  std::uint64_t timestamp = 0;  ///< Seconds since 1970 in 32.32 bits; 0: not stated.
  std::uint64_t body_bytes = 0;
  std::uint64_t crc = 0;

  double time_s() const { return static_cast<double>(timestamp) / 4294967296.0; }
};

/// A surface: what a POLYDATA message holds of use to a stream.
struct PolyData {
  struct Scalar {
    std::string name;
    std::vector<float> values;  ///< One per point.
  };
  std::vector<float> points;           ///< 3 per point.
  std::vector<std::uint32_t> corners;  ///< Of triangles, or of polygons that begin at `offsets`.
  std::vector<std::uint64_t> offsets;  ///< Empty: triangles alone.
  std::vector<Scalar> scalars;         ///< The first of one component per point, at most kMaxScalars.
};

/// Errors: kUnsupported (another version), kTooLarge (a POLYDATA of more than kMaxBodyBytes).
Result<Header> header_from_bytes(std::span<const std::uint8_t, kHeaderBytes> bytes);

/// What a body says, without its extended header and meta data. Errors: kCorrupt (its CRC is another; sizes).
Result<ByteView> content_from_body(const Header& header, ByteView body);

/// Allocates no more than a few times the content's length, whatever sizes it states. Vertices, lines, cell data and
/// attributes that are not PolyData::scalars are left out; strips become triangles.
/// Errors: kCorrupt (sizes; cells of points that are not there).
Result<PolyData> polydata_from_content(ByteView content);

/// A whole message. REQUIRES: corners are triangles; scalars have a value per point.
///   version  of the header: 1 or 2
Bytes message_from_polydata(const PolyData& data, const std::string& device, int version, std::uint64_t timestamp);

/// Cuts what a connection brings into messages. Not thread-safe.
class MessageReader {
 public:
  /// The body of a POLYDATA message, whole. What follows one that is not usable is read on.
  using OnPolyData = std::function<void(const Header& header, ByteView body)>;

  /// Other types are passed over. Errors: as header_from_bytes(): where the next message begins is not known.
  Result<void> take(ByteView bytes, const OnPolyData& on_polydata);

 private:
  enum class State { kHeader, kPolyData, kOther };
  State state_ = State::kHeader;
  Header header_;
  std::uint64_t missing_ = kHeaderBytes;  ///< Bytes until the state changes.
  Bytes buffer_;                          ///< Grows with what has come, not with what was announced.
};

}  // namespace eigencast::igtl
