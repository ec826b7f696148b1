// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "client/clip_source.h"

namespace eigencast {

/// Reads a recording (docs/recording-format.md) whole, with the surface that it holds or that cache_dir has. Poses keep
/// their capture times; pauses, and what lies between two announcements, last 5 s at most. Absent bands read as the
/// rest pose.
///
/// Safe on hostile input. Errors: those of recording::Reader and assemble_asset; kNotFound (the surface is nowhere),
/// kCorrupt, kUnsupported (another surface follows), kTooLarge (over 1 GiB of coefficients), kCancelled.
Result<std::shared_ptr<const BakedClip>> read_recording(const std::string& path, const std::string& cache_dir,
                                                        const BakeProgress& progress = {});

bool is_recording(const std::string& path);  ///< By its ending, .ecrec.

}  // namespace eigencast
