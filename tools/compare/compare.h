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

/// One pose as a client recorded it (eigencast-client --record).
struct RecordedPose {
  std::uint64_t sequence = 0;
  std::uint8_t at = 0;  ///< Step between key sequence-1 and key sequence; at == of (or 0, 0) is the key itself.
  std::uint8_t of = 0;
  TimeUs capture_us = 0;
  std::uint32_t channels = 3;
  std::vector<double> coefficients;  ///< r x c, row-major.

  bool is_key() const { return at == of; }
};

/// Which frame of the clip each capture time was (eigencast-sender play --record).
using SentFrames = std::map<TimeUs, std::size_t>;

struct Comparison {
  SurfaceError keys;          ///< Against the clip's frames.
  SurfaceError interpolated;  ///< Against the linear interpolation of the clip's two frames around the pose.
  std::size_t unmatched = 0;  ///< Poses whose capture time was not in SentFrames.
};

/// Rebuilds every recorded pose at full resolution and compares it with the clip. `asset` must be baked from
/// clip.rest().
/// Errors: kInvalidArgument (a pose whose size does not fit the asset; no pose matches), and those of clip.pose().
Result<Comparison> compare_with_truth(const MotionClip& clip, const Asset& asset, const SentFrames& sent,
                                      const std::vector<RecordedPose>& received);

/// Readers of the two records, JSON lines. Errors: kNotFound, kCorrupt naming the line.
Result<SentFrames> read_sent_frames(const std::string& path);
Result<std::vector<RecordedPose>> read_recorded_poses(const std::string& path);

/// Adds the comparison as member "reconstruction" to the JSON object in `report_path`, or makes that file.
/// Errors: kCorrupt (the file is not a JSON object), kIo.
Result<void> add_to_report(const Comparison& comparison, const std::string& report_path);

/// Two lines for people.
std::string text_from_comparison(const Comparison& comparison);

}  // namespace eigencast
