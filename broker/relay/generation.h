// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/codec/pose_memory.h"
#include "common/core/bytes.h"

namespace eigencast::broker {

/// What a stream's sender and its viewers remember. Immutable; all loops share it. Numbers are the broker's: they grow
/// as long as any loop has the stream, so that those of before never mean what is held now.
struct Generation {
  struct Segment {
    std::string id;  ///< 64 hexadecimal digits.
    std::shared_ptr<const MemorySegment> poses;
    std::uint32_t since = 0;  ///< The first generation that has it.
    std::shared_ptr<const Bytes> coded{};
  };
  std::uint32_t number = 0;
  std::uint32_t root = 0;  ///< Who held this one has the first poses of the later ones; who held none since has none.
  PoseMemory poses;
  std::vector<Segment> segments;

  /// The first generation with what predicts a key at this phase. REQUIRES: poses.has(phase).
  std::uint32_t needed_at(std::uint32_t phase) const {
    std::uint32_t end = 0;
    for (const Segment& segment : segments) {
      end += segment.poses->poses;
      if (phase / PoseMemory::kParts < end) return segment.since;
    }
    return number;
  }
  /// How many of the segments somebody has who was told of a generation.
  std::size_t told_with(std::uint32_t generation) const {
    std::size_t count = 0;
    while (generation >= root && count < segments.size() && segments[count].since <= generation) ++count;
    return count;
  }
};
using GenerationPtr = std::shared_ptr<const Generation>;

}  // namespace eigencast::broker
