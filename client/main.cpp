// SPDX-License-Identifier: MIT
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>

#include "client/apps.h"
#include "client/clip_source.h"
#include "client/stream_list.h"
#include "common/command_line/log.h"
#include "common/core/memory_budget.h"

namespace {

std::atomic<bool> stop_wanted{false};
std::atomic<int> last_signal{0};
static_assert(std::atomic<bool>::is_always_lock_free && std::atomic<int>::is_always_lock_free,
              "a signal handler sets it");

void on_signal(int signal) {
  last_signal.store(signal);
  stop_wanted.store(true);
}

int run(int argc, char** argv) {
  using namespace eigencast;
  auto parsed = options_from_command_line(argc, argv);
  if (const auto* exit_now = std::get_if<ExitNow>(&parsed)) return exit_now->code;
  auto& options = std::get<ClientOptions>(parsed);
  // Read above, for one broker; libraries below would give it to any.
  ::unsetenv("EIGENCAST_TOKEN");

  if (options.memory_mb > 0) received_memory().set_limit(static_cast<std::uint64_t>(options.memory_mb * 1e6));

  const LogSink log = sink_to(stderr_logger(options.verbose ? LogLevel::kDebug : LogLevel::kInfo));
  if (options.list) return run_list(options, log);
  if (options.scene.streams.empty()) {
    const auto chosen = choose_live_stream(options);
    // The window has a welcome to choose from.
    if (!chosen) eigencast::log(log, options.headless ? LogLevel::kError : LogLevel::kDebug, chosen.error().message);
    if (!chosen && options.headless) return kExitNoStream;
  }

  // Not before: a signal ends what waits for a list.
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  if (options.film) {
    const int code = run_film(options, stop_wanted, log);
    return code == kExitStopped ? kExitStopped + last_signal.load() : code;
  }
  std::vector<std::unique_ptr<PoseSource>> sources;
  std::vector<PoseSource*> all;
  for (std::size_t i = 0; i < options.scene.streams.size(); ++i) {
    auto source =
        open_source(options.scene.streams[i], &options.credentials[i], options, !options.headless, stop_wanted, log);
    if (!source) {
      eigencast::log(log, LogLevel::kError, source.error().message);
      return clip_in(options.scene.streams[i]) ? kExitFailed : kExitUsage;
    }
    all.push_back(source->get());
    sources.push_back(std::move(source).value());
  }
  const OpenSource open = [&](const std::string& stream) {
    return open_source(stream, nullptr, options, true, stop_wanted, log);
  };
  return options.headless ? run_headless(options, all, stop_wanted, log)
                          : run_window(options, all, open, stop_wanted, log);
}

}  // namespace

int main(int argc, char** argv) {
  // Libraries below may throw (memory, a disk that is full): that ends the program in order, not by std::terminate.
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "eigencast-client: stopped by an unexpected error: %s\n", error.what());
  } catch (...) {
    std::fputs("eigencast-client: stopped by an unexpected error\n", stderr);
  }
  return eigencast::kExitFailed;
}
