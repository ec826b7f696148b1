// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>

#include "common/recording/writer.h"
#include "common/surface/motion_clip.h"
#include "sdk/bake.h"
#include "sdk/key_writer.h"

namespace eigencast {

/// Writes a clip as the recording of a stream that had sent it once: its surface, keys at the clip's rate, a checkpoint
/// a second. Reads the clip twice; memory does not grow with it.
///   to        a new file
///   progress  fraction in [0, 1]; returns false to stop
/// Errors: those of the clip, naming the frame, of the codec and recording::Writer (kRefused: `to` is there);
/// kCancelled, kIo.
Result<void> record_clip(const MotionClip& clip, const BakeResult& baked, const std::string& to,
                         const BakeProgress& progress);

/// Writes a key that `keys` has coded, and a checkpoint with the first of its chain and once a second.
///   due_us  when the next checkpoint is; changed
/// Errors: those of the codec and recording::Writer.
Result<void> record_key(recording::Writer& writer, KeyWriter& keys, KeyWriter::Coded coded, TimeUs time_us,
                        TimeUs& due_us);

}  // namespace eigencast
