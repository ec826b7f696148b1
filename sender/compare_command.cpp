// SPDX-License-Identifier: MIT
#include <cstdio>

#include "sender/commands.h"
#include "sender/compare.h"

namespace eigencast {

int run(const CompareCommand& command, const Console& console, Interrupt& interrupt) {
  const auto sent = read_sent_frames(command.sent);
  if (!sent) return report_failure(sent.error());
  const auto received = read_recorded_poses(command.received);
  if (!received) return report_failure(received.error());
  const auto source = bake_with_progress(command.source, console, interrupt);
  if (!source) return report_failure(source.error());
  const auto comparison = compare_with_truth(*source->clip, source->baked.asset, *sent, *received);
  if (!comparison) return report_failure(comparison.error());
  std::fputs(text_from_comparison(*comparison).c_str(), stdout);
  if (command.report.empty()) return kExitOk;
  const auto written = add_to_report(*comparison, command.report);
  return written ? kExitOk : report_failure(written.error());
}

}  // namespace eigencast
