// SPDX-License-Identifier: MIT
#pragma once

#include "common/wire/control.h"

namespace eigencast {

/// check_format() but for the scalars' names and units. Errors: kInvalidArgument.
Result<void> check_sizes(const StreamFormat& format);

}  // namespace eigencast
