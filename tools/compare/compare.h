// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/surface/motion_clip.h"
#include "sender/surface_error.h"

namespace eigencast {

/// Reads what eigencast-client --record writes.
struct RecordedPose {
  std::uint64_t sequence = 0;
  std::uint8_t at = 0;  ///< Step between key sequence-1 and key sequence; at == of (or 0, 0) is the key itself.
  std::uint8_t of = 0;
  TimeUs capture_us = 0;
  std::uint32_t channels = 3;
  std::vector<double> coefficients;  ///< r x c, row-major.

  bool is_key() const { return at == of; }
};

/// The frame of each capture time (eigencast-sender play --record).
using SentFrames = std::map<TimeUs, std::size_t>;

struct Comparison {
  SurfaceError keys;          ///< Against the clip's frames.
  SurfaceError interpolated;  ///< Against the linear interpolation of the clip's two frames around the pose.
  std::size_t unmatched = 0;  ///< Poses whose capture time was not in SentFrames.
};

/// `asset`: baked from clip.rest(). Errors: the clip's; kInvalidArgument (a pose does not fit the asset; none matches).
Result<Comparison> compare_with_truth(const MotionClip& clip, const Asset& asset, const SentFrames& sent,
                                      const std::vector<RecordedPose>& received);

/// JSON lines. Errors: as read_file; kCorrupt naming the line.
Result<SentFrames> read_sent_frames(const std::string& path);
Result<std::vector<RecordedPose>> read_recorded_poses(const std::string& path);

/// Writes member "reconstruction" of its JSON object, which may be new. Errors: kCorrupt, kIo.
Result<void> add_to_report(const Comparison& comparison, const std::string& report_path);

std::string text_from_comparison(const Comparison& comparison);

}  // namespace eigencast
