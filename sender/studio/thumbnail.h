// SPDX-License-Identifier: MIT
#pragma once

#include <span>
#include <string>

#include "common/asset/asset.h"
#include "common/core/result.h"

namespace eigencast::studio {

/// Draws a pose (r x 3, row-major) as viewers do, in clay, into a PNG of 480 x 300 pixels. Errors: kUnsupported (no
/// OpenGL without a display), kIo. REQUIRES: asset.complete().
Result<void> write_thumbnail(const Asset& asset, std::span<const double> C, const std::string& path);

}  // namespace eigencast::studio
