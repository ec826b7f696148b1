// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <variant>

#include "common/command_line/command_line.h"
#include "tools/igtl/bridge.h"

namespace eigencast::igtl {

inline constexpr int kExitGood = 0, kExitFailed = 1, kExitUsage = 2;

/// What the command line asks for; or help, a completion script or an error has been printed.
std::variant<Options, ExitNow> options_from_command_line(int argc, const char* const* argv, const std::string& version);

}  // namespace eigencast::igtl
