// SPDX-License-Identifier: MIT
#include "broker/config/options.h"

#include <CLI/CLI.hpp>
#include <utility>
#include <vector>

namespace eigencast::broker {
namespace {

constexpr const char* kFooter =
    "Examples:\n"
    "  eigencast-broker                                         listen on 127.0.0.1:7490\n"
    "  eigencast-broker --listen 127.0.0.1:0 --port-file PORT   any free port, written to PORT\n"
    "  eigencast-broker --config eigencast.toml --check-config  try a configuration\n"
    "Every setting stands in eigencast.toml; EIGENCAST_SECTION__KEY sets it from the environment.\n"
    "Exit codes: 0 ended as asked, 1 failure, 2 usage or configuration, 4 cannot listen.";

/// Flags that stand for a key of the configuration.
struct KeyFlag {
  const char* flag;
  const char* key;
  const char* help;
};
constexpr KeyFlag kKeyFlags[] = {
    {"--listen", "server.listen",
     "Where senders and viewers connect, ADDR:PORT (default: 127.0.0.1:7490; port 0: any)"},
    {"--admin-listen", "server.admin_listen", "Health and metrics, on loopback (default: 127.0.0.1:7491; port 0: off)"},
    {"--data-dir", "server.data_dir",
     "Where assets are kept (default: $XDG_STATE_HOME/eigencast or ~/.local/state/eigencast)"},
    {"--log-level", "log.level", "debug, info, warning or error (default: info)"},
    {"--log-format", "log.format", "text or json (default: text)"},
};

Result<void> merge(Config& config, const std::string& file, std::span<const std::string_view> environment,
                   const std::vector<std::string>& flags) {
  if (!file.empty()) {
    if (auto read = read_config_file(config, file); !read) return read;
  }
  if (auto read = read_environment(config, environment); !read) return read;
  for (std::size_t i = 0; i < flags.size(); ++i) {
    if (flags[i].empty()) continue;
    if (auto set = set_config(config, kKeyFlags[i].key, flags[i]); !set)
      return in_context(kKeyFlags[i].flag, set.error());
  }
  return check_config(config);
}

}  // namespace

Result<Options> read_options(int argc, const char* const* argv, std::span<const std::string_view> environment,
                             std::string_view version) {
  Options options;
  CLI::App app("Relays live deforming surfaces from senders to any number of viewers", "eigencast-broker");
  app.footer(kFooter);
  app.set_version_flag("--version", "eigencast-broker " + std::string(version));
  std::string file;
  std::vector<std::string> flags(std::size(kKeyFlags));
  app.add_option("-c,--config", file, "Configuration file (TOML)");
  for (std::size_t i = 0; i < flags.size(); ++i) app.add_option(kKeyFlags[i].flag, flags[i], kKeyFlags[i].help);
  app.add_option("--port-file", options.port_file, "Write the port to this file once listening");
  app.add_flag("--check-config", options.check_only, "Read and check the configuration, then end");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    std::ostringstream out;
    std::ostringstream err;
    if (app.exit(error, out, err) == 0) {
      options.answer = out.str();
      return options;
    }
    return fail(ErrorCode::kInvalidArgument, err.str());
  }
  if (auto merged = merge(options.config, file, environment, flags); !merged) return merged.error();
  return options;
}

}  // namespace eigencast::broker
