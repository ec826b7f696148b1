// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sdk/key_writer.h"
#include "sdk/pose_projection.h"
#include "sdk/publisher.h"
#include "sdk/sender_memory.h"
#include "sdk/transfer.h"

namespace eigencast {

/// A surface, and the chain of its poses.
struct Sending {
  /// asset  null: of keys alone; coarser: times the spacing of keys' levels
  Sending(const PublisherOptions& options, CodecKind codec, StreamFormat of, std::shared_ptr<const Asset> surface,
          std::shared_ptr<const EncodedAsset> bytes, double coarser = 1);

  const std::shared_ptr<const Asset> asset;
  const std::shared_ptr<const EncodedAsset> encoded;
  const StreamFormat format;
  const Quantiser quantiser;
  PoseProjection projection;  ///< For the caller's thread alone.
  KeyWriter writer;
  SenderMemory memory;
};

/// From what a surface showed to what its next asset shows, over some keys. Pure.
class Ramp {
 public:
  static constexpr int kKeys = 8;

  /// Nothing to ramp where one of them is not of the other's surface.
  Ramp(const Asset& before, const Asset& after)
      : back_(Transfer::between(after, before)), forth_(Transfer::between(before, after)) {}

  /// A key of the asset before as the same pose of the one after; empty: there is none.
  std::vector<double> carried_over(std::span<const double> C, std::size_t channels) const;
  bool is_over() const { return keys_ == kKeys || !back_ || !forth_; }
  /// (1 - w) of what the asset before would show of C, and w of C. REQUIRES: not is_over().
  std::vector<double> blended(std::span<const double> C, std::size_t channels) const;
  void sent() { ++keys_; }

 private:
  std::optional<Transfer> back_, forth_;
  int keys_ = 0;
};

}  // namespace eigencast
