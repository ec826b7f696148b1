// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>

/// Every cap on what an asset may claim: parsers check against these before they allocate.
namespace eigencast::asset_limits {

inline constexpr std::uint32_t kMaxVertices = 16'000'000;
inline constexpr std::uint32_t kMaxFaces = 32'000'000;
inline constexpr std::uint32_t kMaxRank = 4096;
inline constexpr std::size_t kMaxBands = 8;
inline constexpr std::size_t kMaxChunks = 4096;
inline constexpr std::size_t kMaxTilesPerChunk = 64;
inline constexpr std::size_t kMaxSections = 256;
inline constexpr std::size_t kMaxKindBytes = 64;  ///< Of the basis, of the operator.
inline constexpr std::size_t kMaxLevelErrors = 32;
inline constexpr std::size_t kMaxNameBytes = 1024;
inline constexpr std::uint64_t kMaxManifestBytes = std::uint64_t{16} << 20;  ///< More than all other limits allow it.
inline constexpr std::uint64_t kMaxObjectBytes = std::uint64_t{256} << 20;   ///< One chunk, as stored.
inline constexpr std::uint64_t kMaxDecodedBytes = std::uint64_t{4} << 30;    ///< n r floats.
/// What a chunk may grow to in memory: kFreeGrowth + kMaxExpansion times its bytes. A smooth basis expands less than
/// 20-fold.
inline constexpr std::uint64_t kMaxExpansion = 1024;
inline constexpr std::uint64_t kFreeGrowth = std::uint64_t{1} << 20;
/// Writers stop doubling chunks here, so that one object stays easy to hold and to fetch again.
inline constexpr std::uint64_t kTargetChunkBytes = std::uint64_t{32} << 20;

/// Below this a column counts as zero, so that value / scale finds the integer back exactly.
inline constexpr float kMinColumnScale = 1e-30F;
/// So that value * 32767 is finite.
inline constexpr float kMaxColumnScale = 1e34F;
inline bool is_column_scale(float scale) {
  return scale == 0 || (scale >= kMinColumnScale && scale <= kMaxColumnScale);
}

}  // namespace eigencast::asset_limits
