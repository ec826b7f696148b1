// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/core/clock.h"
#include "common/core/result.h"
#include "common/wire/control.h"
#include "sdk/bake.h"

namespace eigencast {

/// All poses of a recorded stream, and its surface.
struct RecordedClip {
  control::StreamInfo info;  ///< As the sender announced it.
  Asset asset;
  std::vector<std::vector<double>> frames;  ///< Each r x c, row-major.
  std::vector<TimeUs> times_us;             ///< Of the frames, ascending from 0.
  std::vector<TimeUs> utc_us;               ///< Likewise, when each was captured: utc_of().

  TimeUs period_us() const;  ///< The last pose lasts as long as the others do.
};

/// Reads a recording (docs/recording-format.md) whole, with the surface that it holds or that cache_dir has. Poses keep
/// their capture times; pauses, and what lies between two announcements, last 5 s at most. Absent bands read as the
/// rest pose. Where the sender goes on in another basis of the surface, all poses are in the last one (Transfer).
///
/// Safe on hostile input. Errors: those of RecordedStream and assemble_asset; kNotFound (the surface is nowhere),
/// kCorrupt, kUnsupported (another
/// surface follows), kTooLarge (over 1 GiB of coefficients), kCancelled.
Result<RecordedClip> read_recording(const std::string& path, const std::string& cache_dir,
                                    const BakeProgress& progress = {});

bool is_recording(const std::string& path);  ///< By its ending, .ecrec.

}  // namespace eigencast
