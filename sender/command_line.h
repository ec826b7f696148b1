// SPDX-License-Identifier: MIT
#pragma once

#include <functional>

#include "sender/commands.h"

namespace eigencast {

/// A command to run, or an exit status at once: help, version, or an error that was printed.
struct Invocation {
  std::function<int(Interrupt&)> run;
  int status = kExitOk;
  bool verbose = false;
};

Invocation parse_command_line(int argc, char** argv);

}  // namespace eigencast
