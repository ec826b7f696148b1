// SPDX-License-Identifier: MIT
#include "tools/latency/commands.h"

#include <CLI/CLI.hpp>
#include <cstdio>

#include "common/command_line/command_line.h"
#include "common/core/files.h"
#include "tools/latency/presenter.h"

namespace eigencast::latency {
namespace {

constexpr const char* kAbout =
    R"(Measures the delay from pose to rebuilt surface, or to its picture, stage by stage.

A pose counts from the time it was meant for (open-loop schedule). Keys and synthetic poses are reported apart; so are
the stages, whose sum is checked against the total. docs/latency.md says how.)";

constexpr const char* kExamples =
    R"(eigencast-latency loop                              # a broker of its own, the heart, 30 poses/s, raw
eigencast-latency loop --interp 3 --clients 1000    # x 3, with 999 light viewers beside the measured one
eigencast-latency loop --present 1440x900           # input to picture
eigencast-latency loop http://broker:7490/test --duration 40 --fail-if 'p99>60ms' --json result.json
eigencast-latency pair --publish http://broker:7490/test --duration 60     # on the one machine
eigencast-latency pair --subscribe http://broker:7490/test --duration 30   # on the other
eigencast-latency passive http://broker:7490/lab/horse                     # of a stream that is there already
eigencast-latency probe http://broker:7490                                 # round trip and clock only
eigencast-latency sweep --rates 30,60 --clients 1,100,1000 --interps 1,3
eigencast-latency compare before.json after.json)";

constexpr const char* kExitStatus = R"(0  good
1  could not measure, or not to the end
2  wrong usage
3  a --fail-if condition held
4  the stages do not add up)";

std::string indented(std::string_view lines) {
  std::string text = "  ";
  for (const char c : lines) text += c == '\n' ? std::string("\n  ") : std::string(1, c);
  return text + "\n";
}

const CLI::Range kRates(0.5, 1000.0), kClients(1, 100000), kInterpolations(1, 15), kRanks(4, 1000);

void add_access(CLI::App& command, Inputs& in) {
  add_credential_options(command, in.credentials)->envname("EIGENCAST_TOKEN");
  for (const char* name : {"--token", "--ca", "--cert", "--key", "--insecure"})
    command.get_option(name)->group("Access");
}

void add_outputs(CLI::App& command, Options& o) {
  const auto file = [](CLI::Option* option) { option->group("Output")->check(output_path(check_output_file)); };
  file(command.add_option("--json", o.json, "write the whole report here (- for standard output)"));
  file(command.add_option("--csv", o.csv, "write a line per second here"));
  file(command.add_option("--hgrm", o.hgrm, "write the percentile spectrum of the keys here (plots as HdrHistogram)"));
  file(command.add_option("--hdr-log", o.hdr_log, "write an HdrHistogram log here, V2"));
  file(command.add_option("--samples", o.samples, "write every traced pose with its stages here (CSV)"));
  command
      .add_option("--fail-if", o.fail_if,
                  "exit 3 if it holds: 'p99>60ms', 'synthetic.p50>30ms', 'in_broker.p50>100us', 'lost>0'")
      ->group("Output");
  command
      .add_flag("--no-progress", o.no_progress,
                "no progress line (there is none where standard error is not a terminal)")
      ->group("Output");
  command.add_flag("--verbose,-v", o.verbose, "say what the connections do")->group("Output");
}

void add_span(CLI::App& command, Inputs& in) {
  command.add_option("--duration", in.duration_s, "seconds measured")
      ->check(CLI::Range(0.2, 1e6))
      ->capture_default_str();
  command.add_option("--warmup", in.warmup_s, "seconds before that")
      ->check(CLI::Range(0.0, 1e4))
      ->capture_default_str();
}

void add_sender(CLI::App& command, Inputs& in) {
  command.add_option("--rate", in.rate_hz, "keys a second")->check(kRates)->capture_default_str();
  command.add_option("--source", in.source, "built-in shape: heart, torus, sphere, bar, heart:fine")
      ->capture_default_str();
  command.add_option("--rank", in.rank, "coefficients per axis")->check(kRanks)->capture_default_str();
  command.add_option("--codec", in.codec, "how coefficients are coded")
      ->check(CLI::IsMember({"quantised", "float32", "float64"}))
      ->capture_default_str();
}

void add_viewer(CLI::App& command, Options& o) {
  Inputs& in = o.inputs;
  add_access(command, in);
  add_span(command, in);
  command.add_option("--interp", in.interpolation, "poses per key: 1 (raw) to 15")
      ->check(kInterpolations)
      ->capture_default_str();
  command.add_option("--lod", in.lod, "share of the vertices that are rebuilt")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command.add_option("--present", in.present,
                     "draw each surface off the screen, so many pixels: 1440x900; the total is then to the picture");
  command.add_option("--trace-every", in.trace_every, "keys whose stages are reported: every one, every second, ...")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command.add_option("--late-ms", in.late_ms, "an older pose counts as late")
      ->check(CLI::Range(0.0, 1e9))
      ->capture_default_str();
  add_outputs(command, o);
}

}  // namespace

Result<PictureSize> picture_size_from_text(const std::string& text) {
  constexpr int kMaxSide = 8192;
  PictureSize size;
  int end = 0;
  if (std::sscanf(text.c_str(), "%dx%d%n", &size.width, &size.height, &end) != 2 ||
      end != static_cast<int>(text.size()) || size.width < 1 || size.height < 1 || size.width > kMaxSide ||
      size.height > kMaxSide)
    return fail(ErrorCode::kInvalidArgument, "--present " + text + ": must be WIDTHxHEIGHT, for example 1440x900");
  return size;
}

std::variant<Options, ExitNow> options_from_command_line(int argc, const char* const* argv,
                                                         const std::string& version) {
  Options o;
  CLI::App app{kAbout, "eigencast-latency"};
  app.footer("Examples:\n" + indented(kExamples) + "\nExit status:\n" + indented(kExitStatus));
  add_help_all(app);
  app.set_version_flag("--version", "eigencast-latency " + version);
  app.require_subcommand(1);

  CLI::App* loop = app.add_subcommand("loop", "sender and viewer in this process, on one clock: exact");
  loop->add_option("url", o.inputs.url, "http://host:port/stream, or https:// (default: a broker of its own)");
  loop->add_option("--viewer-url", o.inputs.viewer_url, "viewers go here instead, for example through a relay");
  loop->add_option("--clients", o.inputs.clients, "viewers; all but one are light")
      ->check(kClients)
      ->capture_default_str();
  add_sender(*loop, o.inputs);
  add_viewer(*loop, o);

  CLI::App* pair = app.add_subcommand("pair", "sender and viewer on two machines, one end each");
  auto* ends = pair->add_option_group("end")->require_option(1);
  std::string publish, subscribe;
  ends->add_option("--publish", publish, "be the sender of this stream");
  ends->add_option("--subscribe", subscribe, "be the viewer of this stream");
  add_sender(*pair, o.inputs);
  add_viewer(*pair, o);

  CLI::App* passive = app.add_subcommand("passive", "watch a stream that somebody else sends");
  passive->add_option("url", o.inputs.url, "http://host:port/stream, or https://")->required();
  add_viewer(*passive, o);

  CLI::App* probe = app.add_subcommand("probe", "round trip to a broker, and the offset of its clock");
  probe->add_option("url", o.inputs.url, "http://host:port, or https://")->required();
  probe->add_option("--count", o.pings, "pings")->check(CLI::Range(1, 100000))->capture_default_str();
  probe->add_option("--json", o.json, "write the result here (- for standard output)")
      ->check(output_path(check_output_file));
  add_access(*probe, o.inputs);

  CLI::App* sweep = app.add_subcommand("sweep", "loop for every combination of the lists");
  sweep->add_option("url", o.inputs.url, "http://host:port/stream, or https:// (default: a broker of its own)");
  sweep->add_option("--rates", o.rates, "keys a second")->check(kRates)->delimiter(',');
  sweep->add_option("--clients", o.clients, "viewers")->check(kClients)->delimiter(',');
  sweep->add_option("--interps", o.interpolations, "poses per key")->check(kInterpolations)->delimiter(',');
  sweep->add_option("--ranks", o.ranks, "coefficients per axis")->check(kRanks)->delimiter(',');
  add_access(*sweep, o.inputs);
  add_span(*sweep, o.inputs);
  sweep->add_option("--source", o.inputs.source, "built-in shape")->capture_default_str();
  sweep->add_option("--lod", o.inputs.lod, "share of the vertices that are rebuilt")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  sweep->add_option("--json", o.json, "write all reports here, as an array (- for standard output)")
      ->check(output_path(check_output_file));
  sweep->add_flag("--no-progress", o.no_progress, "no progress line");

  CLI::App* compare = app.add_subcommand("compare", "two JSON reports side by side");
  compare->add_option("a", o.compare_a, "a report")->required();
  compare->add_option("b", o.compare_b, "another")->required();

  CLI::App* completion = app.add_subcommand("completion", "write a completion script to standard output");
  std::string shell;
  completion->add_option("shell", shell, "for which shell")->required()->check(CLI::IsMember({"bash", "zsh"}));

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitNow{app.exit(error) == 0 ? kExitGood : kExitUsage};
  }
  if (const std::string fault = fault_of_numbers(app); !fault.empty()) {
    std::fprintf(stderr, "%s\n", fault.c_str());
    return ExitNow{kExitUsage};
  }
  if (completion->parsed()) {
    std::fputs(completion_script(app, shell)->c_str(), stdout);
    return ExitNow{kExitGood};
  }
  if (pair->parsed()) {
    o.inputs.mode = publish.empty() ? "subscribe" : "publish";
    o.inputs.url = publish.empty() ? subscribe : publish;
  }
  if (passive->parsed()) o.inputs.mode = "passive";
  if (probe->parsed()) o.command = Options::Command::kProbe;
  if (sweep->parsed()) o.command = Options::Command::kSweep;
  if (compare->parsed()) o.command = Options::Command::kCompare;
  return o;
}

}  // namespace eigencast::latency
