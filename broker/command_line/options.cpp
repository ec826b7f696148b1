// SPDX-License-Identifier: MIT
#include "broker/command_line/options.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <utility>

#include "broker/config/show.h"
#include "common/command_line/command_line.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr const char* kExamples =
    "eigencast-broker                                         # listens on 127.0.0.1:7490\n"
    "eigencast-broker --listen 127.0.0.1:0 --port-file PORT   # any free port, written to PORT\n"
    "eigencast-broker --config eigencast.toml --check-config  # tries a configuration\n"
    "eigencast-broker --default-config                        # all settings, explained\n"
    "eigencast-broker --share                                 # others on this network may watch\n"
    "eigencast-broker token create --static --subject me --publish 'lab/**'  # for a sender";
constexpr const char* kExitStatus = "0  ended as asked\n1  failure\n2  usage or configuration\n4  cannot listen";
constexpr const char* kSettings =
    "Every setting has a flag, --section-name (--limits-max-streams 16), and a name in the environment,\n"
    "EIGENCAST_SECTION__NAME. SIGHUP reads the configuration again.";

/// Path and help of the flags that --help shows; the others are in --default-config.
constexpr std::pair<std::string_view, const char*> kShown[] = {
    {"server.listen", "Where senders and viewers connect, ADDR:PORT (default: 127.0.0.1:7490; port 0: any)"},
    {"server.admin_listen", "Health and metrics (default: 127.0.0.1:7491; empty: off)"},
    {"server.data_dir",
     "Where assets are kept (default: $STATE_DIRECTORY, $XDG_STATE_HOME/eigencast or ~/.local/state/eigencast)"},
    {"log.level", "debug, info, warning or error (default: info)"},
    {"log.format", "text or json (default: text)"},
};

std::string flag_of(const Setting& setting) {
  std::string flag = setting.section == "server" ? std::string() : std::string(setting.section) + "-";
  flag += setting.name;
  std::replace(flag.begin(), flag.end(), '_', '-');
  return "--" + flag;
}

CLI::Option* add_flag(CLI::App& app, const Setting& setting, std::string& value) {
  Config any;
  const bool is_switch = std::holds_alternative<bool*>(setting.field(any));
  const std::string flag = flag_of(setting);
  CLI::Option* option = is_switch ? app.add_flag(flag, value) : app.add_option(flag, value);
  const auto* shown =
      std::find_if(std::begin(kShown), std::end(kShown), [&](const auto& row) { return row.first == setting.path(); });
  if (shown == std::end(kShown)) return option->group("");
  return option->description(shown->second);
}

Error unknown_words(const CLI::App& app) {
  std::vector<std::string> words = app.remaining();
  const auto first = std::find_if(words.begin(), words.end(), [](const auto& word) { return word.starts_with('-'); });
  if (first == words.end())
    return fail(ErrorCode::kInvalidArgument, "'" + words.front() + "' was not expected: see --help");
  const std::string flag = first->substr(0, std::min<std::size_t>(first->find('='), 100));
  std::vector<std::string> flags;
  for (const CLI::Option* option : app.get_options()) {
    for (const std::string& name : option->get_lnames()) flags.push_back("--" + name);
  }
  const std::string meant = closest_to(flag, flags);
  return fail(ErrorCode::kInvalidArgument,
              "unknown flag '" + flag + "'" +
                  (meant.empty() ? ": see --help and --default-config" : "; did you mean '" + meant + "'?"));
}

}  // namespace

Result<Options> read_options(int argc, const char* const* argv, const std::vector<std::string>& environment,
                             std::string_view version) {
  Options options;
  CLI::App app("Relays live deforming surfaces from senders to any number of viewers", "eigencast-broker");
  app.footer(std::string("examples:\n") + kExamples + "\n\n" + kSettings + "\n\nexit status:\n" + kExitStatus);
  add_help_all(app);
  app.set_version_flag("--version", "eigencast-broker " + std::string(version));
  app.add_option("-c,--config", options.sources.file,
                 "Configuration file (TOML; default: eigencast.toml in $CONFIGURATION_DIRECTORY, if there)");
  const auto all = settings();
  std::vector<std::string> values(all.size());
  std::vector<CLI::Option*> flags;
  for (std::size_t i = 0; i < all.size(); ++i) flags.push_back(add_flag(app, all[i], values[i]));
  bool share = false;
  bool show = false;
  bool defaults = false;
  app.add_option("--port-file", options.port_file, "Write the port to this file once listening");
  app.add_flag("--share", share,
               "Let others watch: listen beyond this machine, and print a link and its QR code, whose token views all "
               "streams for 12 hours");
  app.add_flag("--check-config", options.check_only, "Read and check the configuration, then end");
  app.add_flag("--show-config", show, "Print every setting and where its value comes from, then end");
  app.add_flag("--default-config", defaults, "Print the default configuration file with its explanations, then end");
  std::string shell;
  CLI::App* completion = app.add_subcommand("completion", "Write a completion script to standard output");
  completion->add_option("shell", shell, "For which shell")->required()->check(CLI::IsMember({"bash", "zsh"}));
  describe_token_command(app);  // handled before this parser
  try {
    app.parse(argc, argv);
  } catch (const CLI::ExtrasError&) {
    return unknown_words(app);
  } catch (const CLI::ParseError& error) {
    std::ostringstream out;
    std::ostringstream err;
    if (app.exit(error, out, err) == 0) {
      options.answer = out.str();
      return options;
    }
    return fail(ErrorCode::kInvalidArgument, err.str());
  }
  if (completion->parsed()) {
    options.answer = completion_script(app, shell);
    return options;
  }
  if (defaults) {
    options.answer = default_file();
    return options;
  }
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (flags[i]->count() > 0) options.sources.flags.push_back({flag_of(all[i]), all[i].path(), values[i]});
  }
  if (options.sources.file.empty()) options.sources.file = default_config_file();
  options.sources.environment = environment;
  if (share) options.sources.share_secret = random_id(64);
  if (const auto good = store(options.loaded, load_config(options.sources)); !good) return good.error();
  if (show) options.answer = shown_config(options.loaded);
  return options;
}

}  // namespace eigencast::broker
