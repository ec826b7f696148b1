// SPDX-License-Identifier: MIT
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <ctime>
#include <exception>
#include <iostream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "broker/access/policy.h"
#include "broker/backbone/member.h"
#include "broker/broker.h"
#include "broker/command_line/options.h"
#include "broker/command_line/share.h"
#include "broker/operation/logger.h"
#include "common/core/files.h"

extern char** environ;

namespace {

constexpr int kUsage = 2;
constexpr int kCannotListen = 4;

int complain(const eigencast::Error& error, int code) {
  std::fprintf(stderr, "eigencast-broker: %s\n", error.message.c_str());
  return code;
}

int token(int argc, char** argv, const std::vector<std::string>& environment) {
  std::string input;
  if (argc > 0 && std::string_view(argv[argc - 1]) == "-") std::getline(std::cin, input);
  const auto end = eigencast::broker::token_command(argc, argv, environment, std::time(nullptr), input);
  std::fputs(end.err.c_str(), stderr);
  return std::fputs(end.out.c_str(), stdout) < 0 ? 1 : end.code;
}

/// Prints the link, and on a terminal its QR code.
eigencast::Result<void> share(const eigencast::broker::Config& config, const std::string& page) {
  const auto token = eigencast::broker::viewing_token(config, std::time(nullptr));
  if (!token) return token.error();
  if (page.empty()) {
    return eigencast::fail(eigencast::ErrorCode::kUnsupported,
                           "--share needs the page: it is off (web.enabled), or this broker was built without it");
  }
  const std::string link = page + "#access_token=" + *token;
  const std::string code = ::isatty(STDOUT_FILENO) != 0 ? eigencast::broker::qr_code(link) : std::string();
  std::printf("%sWhoever has this link may watch, for 12 hours:\n%s\n", code.c_str(), link.c_str());
  std::fflush(stdout);
  return {};
}

int run(int argc, char** argv) {
  namespace broker = eigencast::broker;
  std::signal(SIGHUP, SIG_IGN);  // Until the broker handles it: what it would read again is being read.
  std::vector<std::string> environment;
  for (char** entry = environ; *entry != nullptr; ++entry) environment.emplace_back(*entry);
  if (argc > 1 && std::string_view(argv[1]) == "token") return token(argc - 1, argv + 1, environment);
  const auto options = broker::read_options(argc, argv, environment, EIGENCAST_VERSION);
  if (!options) return complain(options.error(), kUsage);
  if (options->answer) return std::fputs(options->answer->c_str(), stdout) < 0 ? 1 : 0;
  if (auto security = broker::Broker::load_security(options->loaded.config); !security) {
    return complain(security.error(), kUsage);
  }
  if (auto good = broker::Member::check(options->loaded.config); !good) return complain(good.error(), kUsage);
  const broker::Config& config = options->loaded.config;
  const auto sink = broker::make_log_sink(config);
  const auto warn = [&](const broker::LoadedConfig& loaded) {
    for (const std::string& warning : broker::exposed_secrets(loaded, options->sources.file)) {
      if (!options->check_only) eigencast::log(sink, eigencast::LogLevel::kWarning, warning);
      if (options->check_only) complain(eigencast::fail(eigencast::ErrorCode::kRefused, warning), 0);
    }
  };
  warn(options->loaded);
  if (options->check_only) return std::puts("the configuration is good") < 0 ? 1 : 0;

  // Files are private, unless the mask that was given keeps strangers out already.
  const mode_t usual = ::umask(077);
  if ((usual & S_IRWXO) == S_IRWXO) ::umask(usual);
  std::signal(SIGXFSZ, SIG_IGN);  // A limit on file sizes then acts as a full disk.
  const auto inherited = broker::service_manager::inherited_sockets();
  if (!inherited) return complain(inherited.error(), kUsage);
  auto service = broker::Broker::create(config, EIGENCAST_VERSION, sink, *inherited);
  if (!service)
    return complain(service.error(), service.error().code == eigencast::ErrorCode::kUnreachable ? kCannotListen : 1);
  (*service)->handle_signals([&options, &warn]() -> eigencast::Result<broker::Config> {
    auto loaded = broker::load_config(options->sources);
    if (!loaded) return loaded.error();
    warn(*loaded);
    return std::move(loaded->config);
  });
  if (!options->port_file.empty()) {
    std::string ports = std::to_string((*service)->port()) + "\n";
    if ((*service)->admin_port() != 0) ports += std::to_string((*service)->admin_port()) + "\n";
    const auto written = eigencast::write_file_atomically(options->port_file, ports);
    if (!written) return complain(written.error(), 1);
    (void)::chmod(options->port_file.c_str(), 0666 & ~usual);  // The port is for others.
  }
  const std::string page = (*service)->page_url();
  eigencast::log(sink, eigencast::LogLevel::kInfo,
                 "listening on port " + std::to_string((*service)->port()) +
                     ((*service)->admin_port() != 0 ? ", admin on " + std::to_string((*service)->admin_port()) : "") +
                     (page.empty() ? "" : ", page at " + page));
  if (!options->sources.share_secret.empty()) {
    if (const auto shared = share(config, page); !shared) return complain(shared.error(), kUsage);
  }
  (*service)->run();
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& exception) {
    std::fprintf(stderr, "eigencast-broker: cannot go on: %s\n", exception.what());
    return 1;
  }
}
