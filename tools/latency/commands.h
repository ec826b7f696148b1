// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <string>
#include <variant>
#include <vector>

#include "common/command_line/command_line.h"
#include "tools/latency/session.h"

namespace eigencast::latency {

enum ExitCode : int { kExitGood = 0, kExitFailed = 1, kExitUsage = 2, kExitCondition = 3, kExitWrongSums = 4 };

struct Options {
  enum class Command { kMeasure, kProbe, kSweep, kCompare } command = Command::kMeasure;
  Inputs inputs;
  std::string json, csv, hgrm, hdr_log, samples;  ///< Files; empty: none; "-" (json only): standard output.
  std::vector<std::string> fail_if;
  bool no_progress = false, verbose = false;
  int pings = 20;             ///< Used by probe.
  std::vector<double> rates;  ///< Used by sweep.
  std::vector<std::uint32_t> clients;
  std::vector<int> interpolations, ranks;
  std::string compare_a, compare_b;
};

/// Prints help and usage errors.
std::variant<Options, ExitNow> options_from_command_line(int argc, const char* const* argv, const std::string& version);

/// Returns the exit code. Ends soon, with what it has, when `stop` is set.
int run_command(const Options& options, const std::string& version, const std::atomic<bool>& stop);

}  // namespace eigencast::latency
