// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast {

/// The page in one file that plays recordings (web/src/recording), with {recording} where one goes; empty: this program
/// was built without.
std::string_view player_page();

/// Writes a page that plays a recording, which is inside it as base64: it opens from a disk, without any network. The
/// file gets its name when it is whole.
///   progress  fraction in [0, 1]; returns false to stop
/// Errors: kUnsupported (no page); kNotFound (the recording does not hold its surface); those of recording::Reader;
/// kCancelled, kIo.
Result<void> write_page(const std::string& recording, const std::string& to,
                        const std::function<bool(double)>& progress);

}  // namespace eigencast
