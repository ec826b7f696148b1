// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"

/// Private to common/surface.
namespace eigencast {

/// Those of a folder or of a glob, which must be of one kind, in natural order, or the path itself. A folder with a
/// `vertices.npy` is that file. Errors: kNotFound, kIo, kInvalidArgument, kTooLarge.
Result<std::vector<std::string>> files_of_sequence(const std::string& path);

/// Runs of digits compare as numbers: f2 before f10. A strict total order.
bool natural_less(std::string_view a, std::string_view b);

}  // namespace eigencast
