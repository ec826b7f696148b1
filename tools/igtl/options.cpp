// SPDX-License-Identifier: MIT
#include "tools/igtl/options.h"

#include <CLI/CLI.hpp>
#include <cstdio>

#include "tools/igtl/messages.h"

namespace eigencast::igtl {
namespace {

constexpr const char* kAbout =
    R"(Bridges streams of surfaces and OpenIGTLink: what 3D Slicer sends as POLYDATA becomes a stream, and a stream
POLYDATA.

OpenIGTLink has neither passwords nor encryption: listen elsewhere than on this machine in networks that you trust.)";

constexpr const char* kNotes = R"(Examples:
  eigencast-igtl in http://broker:7490/lab/liver                       # Slicer's connector is a client of port 18944
  eigencast-igtl out http://broker:7490/lab/liver --listen 18945
  eigencast-igtl out http://broker:7490/lab/liver --connect slicer:18944 --scale 0.001   # the stream in m, Slicer in mm

Exit status:
  0  ended by a signal
  1  could not begin
  2  wrong usage
)";

constexpr const char* kDefaultPort = "18944";
constexpr const char* kHere = "127.0.0.1";
constexpr std::size_t kMaxWatchingPeers = 16;

struct Raw {
  std::string listen, connect, up = "z", shell;
};

void add_common(CLI::App& command, Options& options, Raw& raw) {
  command.add_option("url", options.url, "http://host:port/stream, or https://")->required();
  auto* listen = command.add_option("--listen", raw.listen, "wait for peers at PORT of this machine, or at HOST:PORT")
                     ->option_text("[HOST:]PORT");
  command.add_option("--connect", raw.connect, "connect to a peer that waits")
      ->option_text("HOST[:PORT]")
      ->excludes(listen);
  command.add_option("--up", raw.up, "the axis that is up in messages; a stream's is y")
      ->check(CLI::IsMember({"y", "z"}))
      ->capture_default_str();
  command.add_option("--scale", options.scale, "units of the stream in one of messages")
      ->check(CLI::Range(1e-9, 1e9))
      ->capture_default_str();
  command
      .add_option("--max-rate", options.max_rate_hz, "surfaces a second; of those that come faster the newest goes out")
      ->check(CLI::Range(0.01, 1000.0))
      ->capture_default_str();
  add_credential_options(command, options.credentials)->envname("EIGENCAST_TOKEN");
}

int usage(const std::string& what) {
  std::fprintf(stderr, "eigencast-igtl: %s\n", what.c_str());
  return kExitUsage;
}

}  // namespace

std::variant<Options, ExitNow> options_from_command_line(int argc, const char* const* argv,
                                                         const std::string& version) {
  Options options;
  Raw raw;
  CLI::App app{kAbout, "eigencast-igtl"};
  app.footer(kNotes);
  add_help_all(app);
  app.set_version_flag("--version", "eigencast-igtl " + version);
  app.require_subcommand(1);

  CLI::App* in = app.add_subcommand("in", "stream the surface that a peer sends");
  add_common(*in, options, raw);
  in->add_option("--device", options.device, "stream this device's POLYDATA (default: that of the first)");
  in->add_option("--rank", options.rank, "coefficients per axis")->check(CLI::Range(4, 1000))->capture_default_str();
  in->add_option("--error", options.error,
                 "vertex error of coding, in units of the stream (default: 0.1 % of its size)")
      ->check(CLI::Range(0.0, 1e9));

  CLI::App* out = app.add_subcommand("out", "send a stream to peers");
  add_common(*out, options, raw);
  std::string device = "Eigencast";
  out->add_option("--device", device, "name of the messages' device, at most 20 bytes")->capture_default_str();
  out->add_option("--header", options.version, "version of the messages' headers: 1, or 2 for peers that want it")
      ->check(CLI::IsMember({1, 2}))
      ->capture_default_str();

  CLI::App* completion = app.add_subcommand("completion", "write a completion script to standard output");
  completion->add_option("shell", raw.shell, "for which shell")->required()->check(CLI::IsMember({"bash", "zsh"}));

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitNow{app.exit(error) == 0 ? kExitGood : kExitUsage};
  }
  if (const std::string fault = fault_of_numbers(app); !fault.empty()) return ExitNow{usage(fault)};
  if (completion->parsed()) {
    std::fputs(completion_script(app, raw.shell)->c_str(), stdout);
    return ExitNow{kExitGood};
  }
  options.publishes = in->parsed();
  if (out->parsed()) options.device = device;
  if (options.device.size() > kMaxNameBytes) return ExitNow{usage("--device takes at most 20 bytes")};
  options.z_up = raw.up == "z";
  options.peers.listens = raw.connect.empty();
  options.peers.they_send = options.publishes;
  options.peers.max_peers = options.publishes || !options.peers.listens ? 1 : kMaxWatchingPeers;
  const bool named = raw.connect.find_first_not_of("0123456789") != std::string::npos;
  const bool has_port = raw.connect.rfind(':') != std::string::npos && raw.connect.back() != ']';
  const std::string text = options.peers.listens ? raw.listen.empty() ? kDefaultPort : raw.listen
                           : named && !has_port  ? raw.connect + ":" + kDefaultPort
                                                 : raw.connect;
  auto where = endpoint_from_text(text, kHere);
  if (!where) return ExitNow{usage(where.error().message)};
  options.peers.where = *where;
  return options;
}

}  // namespace eigencast::igtl
