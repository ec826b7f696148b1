// SPDX-License-Identifier: MIT
#include "tools/latency/commands.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/command_line/log.h"
#include "common/core/files.h"
#include "common/core/text.h"
#include "common/net/websocket.h"
#include "common/wire/control.h"
#include "tools/latency/presenter.h"
#include "tools/latency/report.h"

extern char** environ;

namespace eigencast::latency {
namespace {

int complain(const Error& error) {
  std::fprintf(stderr, "eigencast-latency: %s\n", escaped(error.message).c_str());
  return error.code == ErrorCode::kInvalidArgument ? kExitUsage : kExitFailed;
}

LogSink log_to_stderr(bool verbose) {
  return sink_to(stderr_logger(verbose ? LogLevel::kDebug : LogLevel::kWarning));
}

OnProgress progress_line(const Options& options) {
  if (options.no_progress || isatty(STDERR_FILENO) == 0) return {};
  return [](const Progress& p) {
    std::fprintf(stderr, "\r%5.1f / %.0f s  %llu keys  %llu synthetic  p50 %.3f ms  p99 %.3f ms \033[K", p.seconds,
                 p.of, static_cast<unsigned long long>(p.keys), static_cast<unsigned long long>(p.synthetic),
                 static_cast<double>(p.p50_us) / 1000, static_cast<double>(p.p99_us) / 1000);
  };
}

Result<void> write_to(const std::string& path, const std::string& text) {
  if (path.empty()) return {};
  if (path != "-") return write_file_atomically(path, text);
  std::fputs(text.c_str(), stdout);
  return {};
}

/// What viewers are to be sent is said by options: a query that is passed over would be measured as something else.
Result<void> check_url(const std::string& text) {
  if (text.empty()) return {};
  const auto url = parse_broker_url(text);
  if (!url) return url.error();
  if (url->query.empty()) return {};
  return fail(ErrorCode::kInvalidArgument,
              url->shown() + ": leave out '?" + url->query + "'; --interp says what viewers are sent");
}

Result<void> check(const Inputs& inputs) {
  for (const std::string& url : {inputs.url, inputs.viewer_url})
    if (auto good = check_url(url); !good) return good;
  if (inputs.clients > 1 && !inputs.url_of_viewers().empty())
    if (const auto good = Load::check_url(inputs.url_of_viewers()); !good) return good.error();
  if (inputs.present.empty()) return {};
  const auto size = picture_size_from_text(inputs.present);
  return size ? Result<void>() : size.error();
}

/// The broker beside this program, as a process of its own on a free port of loopback; its data go with it.
class LocalBroker {
 public:
  /// Errors: kNotFound (no such program), kIo, kTimeout (it does not listen).
  static Result<std::unique_ptr<LocalBroker>> start() {
    std::error_code error;
    const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
    std::string program = (self.parent_path() / "eigencast-broker").string();
    if (error || !std::filesystem::exists(program))
      return fail(ErrorCode::kNotFound, program + ": there is no broker beside this program: give the URL of one");
    std::string folder = (std::filesystem::temp_directory_path() / "eigencast-latency-XXXXXX").string();
    if (mkdtemp(folder.data()) == nullptr) return fail(ErrorCode::kIo, folder + ": cannot be made");
    std::array<std::string, 7> words{program,          "--listen",   "127.0.0.1:0",   "--port-file",
                                     folder + "/port", "--data-dir", folder + "/data"};
    std::array<char*, 8> arguments{};
    for (std::size_t i = 0; i < words.size(); ++i) arguments[i] = words[i].data();
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, (folder + "/log").c_str(), O_WRONLY | O_CREAT, 0600);
    posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setflags(&attributes,
                             POSIX_SPAWN_SETPGROUP);  // Ctrl-C is for us: we end the broker when we are done.
    pid_t pid = -1;
    const int failed = posix_spawn(&pid, program.c_str(), &actions, &attributes, arguments.data(), environ);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
    if (failed != 0) return fail(ErrorCode::kIo, program + ": cannot be started");
    std::unique_ptr<LocalBroker> broker(new LocalBroker(pid, folder));
    for (int i = 0; i < 500; ++i) {
      std::ifstream(folder + "/port") >> broker->port_;
      if (!broker->port_.empty()) return broker;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return fail(ErrorCode::kTimeout, program + ": does not listen");
  }

  ~LocalBroker() {
    kill(pid_, SIGTERM);
    int status = 0;
    for (int i = 0; i < 200 && waitpid(pid_, &status, WNOHANG) == 0; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    if (waitpid(pid_, &status, WNOHANG) == 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, &status, 0);
    }
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }

  LocalBroker(const LocalBroker&) = delete;
  LocalBroker& operator=(const LocalBroker&) = delete;
  std::string url(const std::string& stream) const { return "ws://127.0.0.1:" + port_ + "/" + stream; }

 private:
  LocalBroker(pid_t pid, std::string folder) : pid_(pid), folder_(std::move(folder)) {}
  pid_t pid_;
  std::string folder_, port_;
};

/// `own` holds a broker of our own.
Result<void> choose_broker(Inputs& inputs, std::unique_ptr<LocalBroker>& own) {
  if (!inputs.url.empty()) return {};
  if (const auto good = store(own, LocalBroker::start()); !good) return good.error();
  inputs.url = own->url("latency");
  inputs.credentials = {};  // They are for somebody else's.
  return {};
}

Result<void> write_reports(const Options& options, const Outcome& outcome, const std::string& version) {
  if (auto w = write_to(options.json, json_report(outcome, version)); !w) return w;
  if (auto w = write_to(options.csv, csv_report(outcome)); !w) return w;
  if (auto w = write_to(options.hgrm, outcome.keys.spectrum(1000)); !w) return w;
  if (auto w = write_to(options.hdr_log, hdr_log(outcome)); !w) return w;
  return write_to(options.samples, samples_report(outcome));
}

int measure(const Options& options, const std::string& version, const std::atomic<bool>& stop) {
  Inputs inputs = options.inputs;
  if (const auto good = check(inputs); !good) return complain(good.error());
  for (const std::string& condition : options.fail_if)
    if (const auto known = judged(condition, Outcome{}); !known) return complain(known.error());
  std::unique_ptr<LocalBroker> own;
  if (auto chosen = choose_broker(inputs, own); !chosen) return complain(chosen.error());
  const OnProgress progress = progress_line(options);
  const auto outcome = run_session(inputs, stop, progress, log_to_stderr(options.verbose));
  if (progress) std::fputs("\r\033[K", stderr);
  if (!outcome) return complain(outcome.error());
  const auto& o = options;
  const bool report_on_stdout = o.json == "-" || o.csv == "-" || o.hgrm == "-" || o.hdr_log == "-" || o.samples == "-";
  std::fputs(table(*outcome).c_str(), report_on_stdout ? stderr : stdout);
  if (auto written = write_reports(options, *outcome, version); !written) return complain(written.error());
  int code = kExitGood;
  for (const std::string& condition : options.fail_if) {
    const auto verdict = judged(condition, *outcome);
    if (!verdict) return complain(verdict.error());
    if (!verdict->holds) continue;
    std::fprintf(stderr, "eigencast-latency: %s\n", verdict->text.c_str());
    code = kExitCondition;
  }
  if (sums_are_wrong(*outcome)) return kExitWrongSums;
  return outcome->trouble.empty() ? code : int{kExitFailed};
}

template <typename T>
std::vector<T> or_else(const std::vector<T>& list, T value) {
  return list.empty() ? std::vector<T>{value} : list;
}

int sweep(const Options& options, const std::string& version, const std::atomic<bool>& stop) {
  Inputs base = options.inputs;
  for (const std::uint32_t clients : options.clients) base.clients = std::max(base.clients, clients);
  if (const auto good = check(base); !good) return complain(good.error());
  std::unique_ptr<LocalBroker> own;
  if (auto chosen = choose_broker(base, own); !chosen) return complain(chosen.error());
  nlohmann::ordered_json reports = nlohmann::ordered_json::array();
  std::printf("%7s %8s %6s %5s | %9s %9s | %9s %9s | %9s %7s %6s %5s\n", "keys/s", "viewers", "interp", "rank",
              "key p50", "p99", "synth p50", "p99", "in broker", "kbit/s", "lost", "CPU%");
  bool wrong = false;
  for (const int rank : or_else(options.ranks, base.rank))
    for (const double rate : or_else(options.rates, base.rate_hz))
      for (const std::uint32_t clients : or_else(options.clients, base.clients))
        for (const int interpolation : or_else(options.interpolations, base.interpolation)) {
          if (stop) return kExitFailed;
          Inputs inputs = base;
          inputs.rank = rank;
          inputs.rate_hz = rate;
          inputs.clients = clients;
          inputs.interpolation = interpolation;
          const auto o = run_session(inputs, stop, progress_line(options), log_to_stderr(false));
          if (!options.no_progress && isatty(STDERR_FILENO) != 0) std::fputs("\r\033[K", stderr);
          if (!o) return complain(o.error());
          const auto ms = [](const HdrHistogram& h, double p) {
            const auto value = h.reliable_percentile(p);
            return value ? formatted("%.3f", static_cast<double>(*value) / 1000) : std::string("-");
          };
          std::printf("%7g %8u %6d %5d | %9s %9s | %9s %9s | %9s %7.1f %6llu %5.0f\n", rate, clients, interpolation,
                      rank, ms(o->keys, 50).c_str(), ms(o->keys, 99).c_str(), ms(o->synthetic, 50).c_str(),
                      ms(o->synthetic, 99).c_str(),
                      ms(o->key_stages[static_cast<std::size_t>(Stage::kInBroker)], 50).c_str(), o->kbit_per_s,
                      static_cast<unsigned long long>(o->counts.keys_lost), 100 * o->cpu_share);
          for (const Warning& warning : warnings_of(*o)) std::printf("        WARNING: %s\n", warning.text.c_str());
          std::fflush(stdout);
          wrong = wrong || sums_are_wrong(*o);
          reports.push_back(nlohmann::ordered_json::parse(json_report(*o, version)));
        }
  if (auto written = write_to(options.json, reports.dump(2) + "\n"); !written) return complain(written.error());
  return wrong ? int{kExitWrongSums} : int{kExitGood};
}

class Prober {
 public:
  Prober(const BrokerUrl& url) {
    WebSocketOptions options;
    options.url = url;
    options.target = "/v1/subscribe";
    WebSocketEvents events;
    events.on_open = [this](const BrokerUrl&) { note([this] { open_ = true; }); };
    events.on_text = [this](std::string_view text) { on_text(text); };
    events.on_down = [this](const Error& why, std::chrono::milliseconds) {
      note([&] {
        open_ = false;
        trouble_ = why.message;
      });
    };
    socket_ = WebSocket::start(std::move(options), std::move(events));
  }
  ~Prober() { socket_->stop(); }

  Result<void> run(int count, const std::atomic<bool>& stop) {
    if (!wait([this] { return open_; }))
      return fail(ErrorCode::kUnreachable, trouble_.empty() ? "no answer" : trouble_);
    for (int i = 1; i <= count && !stop; ++i) {
      (void)socket_->send_text(text_from_control(control::Ping{static_cast<std::uint64_t>(i), steady_now_us()}));
      if (!wait([&] { return answered_ >= i || !open_; }) || answered_ < i)
        return fail(ErrorCode::kTimeout, "ping " + std::to_string(i) + " was not answered " + trouble_);
    }
    return {};
  }

  HdrHistogram round_trip_us;
  ClockTrack clock;

 private:
  void on_text(std::string_view text) {
    const TimeUs now = steady_now_us();
    const auto message = control_from_text(text);
    if (!message) return;
    const auto* pong = std::get_if<control::Pong>(&*message);
    if (pong == nullptr) return;
    note([&] {
      const TimeUs trip_us = now - pong->time_us;
      round_trip_us.add(trip_us);
      clock.add({now, pong->peer_time_us - (pong->time_us + now) / 2, (trip_us + 1) / 2});
      answered_ = static_cast<int>(pong->id);
    });
  }
  template <typename Change>
  void note(Change change) {
    {
      const std::lock_guard lock(mutex_);
      change();
    }
    changed_.notify_all();
  }
  template <typename Condition>
  bool wait(Condition condition) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, std::chrono::seconds(5), condition);
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  bool open_ = false;
  int answered_ = 0;
  std::string trouble_;
  std::unique_ptr<WebSocket> socket_;
};

int probe(const Options& options, const std::string& version, const std::atomic<bool>& stop) {
  auto url = parse_broker_url(options.inputs.url);
  if (!url) return complain(url.error());
  if (auto usable = complete_credentials(*url, options.inputs.credentials, log_to_stderr(false)); !usable)
    return complain(usable.error());
  Prober prober(*url);
  if (const auto done = prober.run(options.pings, stop); !done) return complain(done.error());
  const HdrHistogram& trip = prober.round_trip_us;
  const auto best = prober.clock.best();
  std::printf("%s: %llu pings, round trip min %.3f p50 %.3f max %.3f ms (whole way, not half)\n", url->origin().c_str(),
              static_cast<unsigned long long>(trip.count()), static_cast<double>(trip.min()) / 1000,
              static_cast<double>(trip.percentile(50)) / 1000, static_cast<double>(trip.max()) / 1000);
  if (best)
    std::printf("clock: the broker's is ahead of ours by %+.3f ms +- %.3f\n",
                static_cast<double>(best->offset_us) / 1000, static_cast<double>(best->error_us) / 1000);
  nlohmann::ordered_json json{
      {"schema", "eigencast-latency-probe"}, {"schema_version", kReportSchema}, {"url", url->origin()}};
  for (const auto& [name, value] : environment(version, options.inputs.url)) json["environment"][name] = value;
  json["count"] = trip.count();
  json["round_trip"] = {{"min_us", trip.min()}, {"p50_us", trip.percentile(50)}, {"max_us", trip.max()}};
  if (best) json["clock"] = {{"offset_us", best->offset_us}, {"error_us", best->error_us}};
  if (auto written = write_to(options.json, json.dump(2) + "\n"); !written) return complain(written.error());
  return kExitGood;
}

}  // namespace

int run_command(const Options& options, const std::string& version, const std::atomic<bool>& stop) {
  using Command = Options::Command;
  if (options.command == Command::kMeasure) return measure(options, version, stop);
  if (options.command == Command::kProbe) return probe(options, version, stop);
  if (options.command == Command::kSweep) return sweep(options, version, stop);
  const auto compared = comparison(options.compare_a, options.compare_b);
  if (!compared) return complain(compared.error());
  std::fputs(compared->c_str(), stdout);
  return kExitGood;
}

}  // namespace eigencast::latency
