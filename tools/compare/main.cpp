// SPDX-License-Identifier: MIT
#include <CLI/CLI.hpp>
#include <cstdio>

#include "sender/option_groups.h"
#include "tools/compare/compare.h"

namespace eigencast {
namespace {

Result<void> compare(const SourceOptions& options, const std::string& sent_path, const std::string& received_path,
                     const std::string& report_path) {
  const auto sent = read_sent_frames(sent_path);
  if (!sent) return sent.error();
  const auto received = read_recorded_poses(received_path);
  if (!received) return received.error();
  const auto source = bake_source(options, {});
  if (!source) return source.error();
  const auto comparison = compare_with_truth(*source->clip, source->baked.asset, *sent, *received);
  if (!comparison) return comparison.error();
  std::fputs(text_from_comparison(*comparison).c_str(), stdout);
  return report_path.empty() ? Result<void>() : add_to_report(*comparison, report_path);
}

}  // namespace
}  // namespace eigencast

int main(int argc, char** argv) {
  CLI::App app("Compares poses that a client recorded with the clip that was sent.", "eigencast-compare");
  eigencast::SourceOptions source;
  std::string sent, received, report;
  eigencast::add_source_options(app, source);
  app.add_option("--sent", sent, "record of the sender (eigencast-sender play --record)")->required();
  app.add_option("--received", received, "record of the client (eigencast-client --record)")->required();
  app.add_option("--report", report, "JSON file to add the result to");
  CLI11_PARSE(app, argc, argv);
  const auto compared = eigencast::compare(source, sent, received, report);
  if (!compared) std::fprintf(stderr, "eigencast-compare: %s\n", compared.error().message.c_str());
  return compared ? 0 : 1;
}
