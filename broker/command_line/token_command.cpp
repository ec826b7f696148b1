// SPDX-License-Identifier: MIT
#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <memory>
#include <sstream>
#include <utility>

#include "broker/access/policy.h"
#include "broker/command_line/options.h"

namespace eigencast::broker {
namespace {

constexpr int kRefusedCode = 1;
constexpr int kUsageCode = 2;
constexpr std::int64_t kMaxS = std::int64_t{10} * 365 * 86'400;

constexpr const char* kFooter =
    "Examples:\n"
    "  eigencast-broker token create -c eigencast.toml --subject camera-1 --publish 'lab/**' --valid 30d\n"
    "  eigencast-broker token create --key 'main ES256 /etc/eigencast/main-private.pem' --subscribe '**' --valid 1h\n"
    "  eigencast-broker token create --static --subject camera-1 --publish 'lab/**'\n"
    "  eigencast-broker token inspect -c eigencast.toml TOKEN --publish lab/horse\n"
    "Exit codes: 0 done, 1 the token would be refused, 2 usage or configuration.";

struct Arguments {
  std::string config_file;
  std::string key;
  std::string subject;
  std::vector<std::string> publish;
  std::vector<std::string> subscribe;
  std::vector<std::string> speak;
  std::vector<std::string> rewind;
  bool admin = false;
  bool is_static = false;
  std::string valid = "30d";
  std::string token;
};

CommandEnd failed(const Error& error, int code = kUsageCode) {
  return {code, {}, "eigencast-broker: " + error.message + "\n"};
}

/// "90", "90s", "15m", "12h", "30d" in seconds.
Result<std::int64_t> seconds_from(const std::string& text) {
  constexpr std::pair<char, std::int64_t> kUnits[] = {{'s', 1}, {'m', 60}, {'h', 3600}, {'d', 86'400}};
  std::string_view digits = text;
  std::int64_t unit = 1;
  for (const auto& [letter, seconds] : kUnits) {
    if (!digits.ends_with(letter)) continue;
    digits.remove_suffix(1);
    unit = seconds;
    break;
  }
  std::int64_t number = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
  if (error != std::errc() || end != digits.data() + digits.size() || number < 1 || number > kMaxS / unit) {
    return fail(ErrorCode::kInvalidArgument,
                "--valid " + text + ": write how long, such as 90s, 15m, 12h or 30d, at most 3650d");
  }
  return number * unit;
}

Result<TokenKey> signing_key(const Arguments& arguments, const AccessPolicy& policy) {
  if (!arguments.key.empty()) return key_from_setting(arguments.key);
  for (const TokenKey& key : policy.token_rules().keys) {
    if (key.can_sign()) return key;
  }
  return fail(ErrorCode::kInvalidArgument,
              "the configuration has no key that can sign (a public key only checks): give one with --key \"KEY-ID "
              "ALGORITHM FILE\", or make a fixed token with --static");
}

CommandEnd create_static(const Arguments& arguments) {
  const auto made = create_static_token(arguments.subject, arguments.publish, arguments.subscribe, arguments.admin,
                                        arguments.speak, arguments.rewind);
  if (!made) return failed(made.error());
  return {0, made->token + "\n",
          "put this line into the file that access.tokens_file names, and reload the broker; the token itself is "
          "kept nowhere:\n" +
              made->line + "\n"};
}

CommandEnd create(const Arguments& arguments, const AccessPolicy& policy, std::int64_t now_s) {
  if (arguments.publish.empty() && arguments.subscribe.empty() && !arguments.admin) {
    return failed(fail(ErrorCode::kInvalidArgument,
                       "a token without rights opens nothing: give --publish, --subscribe or --admin"));
  }
  if (arguments.is_static) return create_static(arguments);
  const auto valid_s = seconds_from(arguments.valid);
  if (!valid_s) return failed(valid_s.error());
  const auto key = signing_key(arguments, policy);
  if (!key) return failed(key.error());
  const TokenRules& rules = policy.token_rules();
  const auto token =
      create_token({arguments.subject, rules.audience, rules.issuer, arguments.publish, arguments.subscribe,
                    arguments.admin, now_s, now_s + *valid_s, arguments.speak, arguments.rewind},
                   *key);
  if (!token) return failed(token.error());
  const std::string warning = arguments.key.empty() ? std::string() : exposure_of(key_file_of(arguments.key));
  return {0, *token + "\n", warning.empty() ? warning : "eigencast-broker: " + warning + "\n"};
}

std::string listed(const StreamPatterns& patterns) {
  std::string out;
  for (const std::string& text : patterns.texts()) out += (out.empty() ? "" : " ") + text;
  return out.empty() ? "nothing" : out;
}

CommandEnd inspect(const Arguments& arguments, const AccessPolicy& policy, std::int64_t now_s) {
  CommandEnd end;
  if (const auto parts = read_token(arguments.token)) {
    end.out = "header " + parts->header + "\nclaims " + parts->claims + "\n";
  }
  AccessRequest request;
  request.query_token = arguments.token;
  const auto found = policy.identify(request, now_s);
  if (const auto* denied = std::get_if<Denial>(&found)) {
    end.out += "refused: " + denied->message + "\n";
    end.code = kRefusedCode;
    return end;
  }
  const auto& identity = std::get<Identity>(found);
  end.out += "accepted: " + identity.name + "\n";
  end.out += "may publish   " + listed(identity.rights.publish) + "\n";
  end.out += "may subscribe " + listed(identity.rights.subscribe) + "\n";
  end.out += "may speak in  " + listed(identity.rights.speak) + "\n";
  end.out += "may rewind    " + listed(identity.rights.rewind) + "\n";
  end.out += std::string("admin         ") + (identity.rights.admin ? "yes" : "no") + "\n";
  const auto ask = [&](const std::vector<std::string>& streams, const StreamPatterns& patterns, const char* what) {
    for (const std::string& stream : streams) {
      const bool may = patterns.matches(stream);
      end.out += std::string(may ? "may " : "may not ") + what + " " + stream + "\n";
      if (!may) end.code = kRefusedCode;
    }
  };
  ask(arguments.publish, identity.rights.publish, "publish");
  ask(arguments.subscribe, identity.rights.subscribe, "subscribe");
  ask(arguments.speak, identity.rights.speak, "speak in");
  ask(arguments.rewind, identity.rights.rewind, "rewind");
  if (arguments.admin && !identity.rights.admin) end.code = kRefusedCode;
  return end;
}

void add_options(CLI::App& app, Arguments& arguments, bool creates) {
  const char* verb = creates ? "Streams that its holder may " : "Ask also whether its holder may ";
  app.add_option("-c,--config", arguments.config_file, "The broker's configuration file");
  app.add_option("--publish", arguments.publish, verb + std::string("send, patterns such as lab/** (repeatable)"));
  app.add_option("--subscribe", arguments.subscribe, verb + std::string("watch (repeatable)"));
  app.add_option("--speak", arguments.speak, verb + std::string("speak in, of the rooms that --subscribe lets watch"));
  app.add_option("--rewind", arguments.rewind, verb + std::string("rewind, of those that --subscribe lets watch"));
  app.add_flag("--admin", arguments.admin, creates ? "Its holder may administer" : "Ask also for the right admin");
}

constexpr const char* kDescription = "Makes tokens and says what they are good for";

/// The command "create". `arguments` must outlive `app`.
CLI::App* add_commands(CLI::App& app, Arguments& arguments) {
  app.footer(kFooter);
  app.require_subcommand(1);
  CLI::App* make = app.add_subcommand("create", "Make a token, signed (JWT) or fixed");
  add_options(*make, arguments, true);
  make->add_option("--subject", arguments.subject, "Whom it is for, as logs name it");
  make->add_option("--key", arguments.key, "\"KEY-ID ALGORITHM FILE\" to sign with (default: the configured one)");
  make->add_option("--valid", arguments.valid, "For how long: 90s, 15m, 12h, 30d (default: 30d)");
  make->add_flag("--static", arguments.is_static, "A fixed token, and its line for access.tokens_file");
  CLI::App* inspect = app.add_subcommand("inspect", "Say what a token grants, or why it would be refused");
  add_options(*inspect, arguments, false);
  inspect->add_option("token", arguments.token, "The token, or - to read it from standard input")->required();
  return make;
}

}  // namespace

CommandEnd token_command(int argc, const char* const* argv, const std::vector<std::string>& environment,
                         std::int64_t now_unix_s, const std::string& input) {
  Arguments arguments;
  CLI::App app(kDescription, "eigencast-broker token");
  const CLI::App* making = add_commands(app, arguments);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    std::ostringstream out;
    std::ostringstream err;
    const bool answered = app.exit(error, out, err) == 0;
    return {answered ? 0 : kUsageCode, out.str(), err.str()};
  }
  if (arguments.token == "-") {
    arguments.token = input.substr(0, std::min(input.find_first_of(" \r\n"), kMaxTokenBytes + 1));
  }
  const std::string& file = arguments.config_file;
  const auto loaded = load_config({file.empty() ? default_config_file() : file, environment, {}});
  if (!loaded) return failed(loaded.error());
  const auto policy = AccessPolicy::from_config(loaded->config);
  if (!policy) return failed(policy.error());
  return making->parsed() ? create(arguments, **policy, now_unix_s) : inspect(arguments, **policy, now_unix_s);
}

void describe_token_command(CLI::App& app) {
  const auto arguments = std::make_shared<Arguments>();
  CLI::App* token = app.add_subcommand("token", kDescription);
  add_commands(*token, *arguments);
  token->callback([arguments] {});  // keeps them alive as long as `app`
}

}  // namespace eigencast::broker
