// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "common/core/result.h"
#include "common/surface/motion_clip.h"

/// glTF 2.0, as text or binary. Private to common/surface, and its fuzzer.
namespace eigencast {

/// All surfaces of the file's scene as one, deformed by one of its animations (sampled at options.rate_hz) or unmoved:
/// skins, morph targets, moving nodes. Vertices that a file repeats along seams (same position, same motion) become
/// one. Triangles, strips and fans; points where there are no faces. Opens only files below its folder. Poses are
/// rounded to 32-bit floats, as renderers compute them. Errors: kCorrupt, kUnsupported (an extension that must be
/// understood), kTooLarge, kIo, kNotFound (no such animation, listing those there are).
Result<std::unique_ptr<MotionClip>> open_gltf_clip(const std::string& path, const ClipOptions& options);

/// `folder` is where files beside it lie, empty: none may be read.
Result<std::unique_ptr<MotionClip>> gltf_clip_from_bytes(std::string_view bytes, const std::string& folder,
                                                         const std::string& name, const ClipOptions& options);

}  // namespace eigencast
