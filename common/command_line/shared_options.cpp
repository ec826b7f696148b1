// SPDX-License-Identifier: MIT
#include "common/command_line/shared_options.h"

#include <CLI/CLI.hpp>

namespace eigencast {

CLI::Option* add_credential_options(CLI::App& app, Credentials& credentials) {
  CLI::Option* token = app.add_option("--token", credentials.token, "token for the broker, or @FILE that holds it");
  app.add_option("--ca", credentials.ca_file, "PEM file of the authorities trusted for wss:// (default: the system's)");
  app.add_option("--cert", credentials.certificate_file, "PEM file of a certificate for brokers that ask for one");
  app.add_option("--key", credentials.key_file, "PEM file of its private key");
  app.add_flag("--insecure", credentials.insecure, "do not check the broker's certificate: for trying out only");
  return token;
}

CLI::Validator place_for(Result<void> (*check)(const std::string& path)) {
  return CLI::Validator(
      [check](std::string& path) -> std::string {
        const auto usable = path == "-" ? Result<void>() : check(path);
        return usable ? std::string() : usable.error().message;
      },
      "");
}

}  // namespace eigencast
