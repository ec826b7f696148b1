// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/surface/surface.h"

namespace eigencast::bench {

/// The surface that a benchmark's argument names: a file, or heart:N, ico:LEVEL, torus:ROWS, bar for a built-in one;
/// then, if wanted, ^K: each triangle split in four K times; and @N: contracted to N vertices. Ends the program, with
/// words, where there is none.
Surface named_surface(const std::string& name);

}  // namespace eigencast::bench
