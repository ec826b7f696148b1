// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>

/// Every cap on what may come from the network. Parsers check these before they allocate.
namespace eigencast::limits {

inline constexpr std::uint32_t kMaxRows = 4096;                      ///< r: coefficients per channel.
inline constexpr std::uint32_t kMaxChannels = 16;                    ///< c: 3 for positions, more for scalar fields.
inline constexpr std::size_t kMaxCoefficients = 32768;               ///< r * c; a join of doubles then fits a frame.
inline constexpr std::size_t kMaxBands = 8;                          ///< one bit each in the envelope.
inline constexpr std::size_t kMaxFrameBytes = std::size_t{1} << 20;  ///< envelope and payload.
inline constexpr std::size_t kMaxControlBytes = 64 * 1024;           ///< one JSON text message.
inline constexpr int kMaxControlDepth = 8;                           ///< nesting of JSON.
inline constexpr std::size_t kMaxStreamNameBytes = 128;
inline constexpr std::uint8_t kMaxInterpolation = 15;                        ///< k of "interpolate x k".
inline constexpr std::size_t kMaxAssetObjectBytes = std::size_t{256} << 20;  ///< one manifest or chunk.
inline constexpr std::size_t kMaxAcksPerMessage = 64;
inline constexpr std::size_t kMaxTraceStages = 32;
inline constexpr std::size_t kMaxMemorySegments = 256;  ///< of a generation of a pose memory.
inline constexpr std::size_t kMaxTextBytes = 4096;      ///< one string in a control message.
inline constexpr std::size_t kMaxRooms = 4;             ///< that one connection is in.
inline constexpr std::size_t kMaxRoomMembers = 1024;
inline constexpr std::size_t kMaxRoomNameBytes = 64;     ///< of a member.
inline constexpr std::size_t kMaxRoomKeys = 64;          ///< of a member.
inline constexpr std::size_t kMaxRoomValueBytes = 2048;  ///< of one value, as JSON.
inline constexpr int kMaxRoomValueDepth = 4;             ///< its nesting.
inline constexpr std::size_t kMaxRoomFloors = 8;
inline constexpr std::size_t kMaxSpans = 64;  ///< of a history.
inline constexpr double kMaxSpeed = 10;       ///< at which it is seen; the least is its inverse.
inline constexpr std::int64_t kMaxTimeUs =
    (std::int64_t{1} << 62) - 1;                             ///< stamps are 0..this: differences never overflow.
inline constexpr std::uint32_t kMaxVelocityUs = 10'000'000;  ///< time in which a velocity channel's movement is made.
inline constexpr double kMaxScalar = 1e30;                   ///< ranges and scales of scalar channels.
inline constexpr std::uint32_t kMaxVertices = 16'000'000;
inline constexpr std::uint32_t kMaxFaces = 32'000'000;

}  // namespace eigencast::limits
