// SPDX-License-Identifier: MIT
#pragma once

#include "common/wire/control.h"
#include "web/core/core.h"

namespace eigencast::web {

/// Of a `stream` or `announce` message; its scalars have no names. Errors: kInvalidArgument.
Result<StreamFormat> format_from(const core_format& given);

}  // namespace eigencast::web
