// SPDX-License-Identifier: MIT
#include "broker/broker.h"

#include <sys/resource.h>

#include <algorithm>
#include <boost/asio/ip/udp.hpp>
#include <boost/asio/post.hpp>
#include <csignal>
#include <ctime>
#include <filesystem>
#include <random>
#include <utility>

#include "broker/config/show.h"
#include "broker/connections/connection.h"
#include "broker/http/http_session.h"
#include "broker/http/web_page.h"
#include "broker/operation/admin.h"
#include "common/core/clock.h"
#include "common/core/files.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kDiskThreads = 2;
constexpr std::uint32_t kRestartRetryMs = 500;
constexpr std::uint64_t kReturnsPerSecond = 2000;  ///< Reconnections after a restart.
constexpr std::int64_t kShortCertificateS = 14 * 86'400;
constexpr rlim_t kMaxOtherDescriptors = 1024;  ///< Of files, NATS, listeners and the admin port.

/// Connections that this process has descriptors for: all but a quarter, or kMaxOtherDescriptors. Shells give few until
/// one asks for more.
std::int64_t connections_by_descriptors() {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  limit.rlim_cur = limit.rlim_max;
  if (::setrlimit(RLIMIT_NOFILE, &limit) != 0) ::getrlimit(RLIMIT_NOFILE, &limit);
  return static_cast<std::int64_t>(std::min<rlim_t>(limit.rlim_cur, 1 << 30) -
                                   std::min(limit.rlim_cur / 4, kMaxOtherDescriptors));
}

Recorder::Settings recorder_settings(const Config& config, const std::string& version) {
  return {.folder = data_dir_of(config) + "/recordings",
          .software = "eigencast-broker " + version,
          .streams = StreamPatterns::from(config.recording.streams).value(),  // Checked by create().
          .include_asset = config.recording.include_asset,
          .max_queued_bytes = config.recording.max_queued_bytes,
          .max_total_bytes = static_cast<std::uint64_t>(config.recording.max_total_bytes)};
}

Recorder::Settings history_settings(const Config& config, const std::string& version) {
  Recorder::Settings settings = recorder_settings(config, version);
  settings.folder = data_dir_of(config) + "/history";
  settings.streams = StreamPatterns::from(config.history.streams).value();  // Checked by create().
  settings.include_asset = false;
  settings.max_total_bytes = static_cast<std::uint64_t>(config.history.max_bytes);
  settings.checkpoint_us = 5'000'000;
  settings.keep_us = config.history.minutes * 60'000'000;
  return settings;
}

std::uint64_t unix_now_s() {
  return static_cast<std::uint64_t>(std::time(nullptr));
}

/// The end of the epochs that earlier runs may have given. 0: there was none.
std::uint32_t read_epochs_end(const std::string& path, const LogSink& sink) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored)) return 0;
  const auto text = read_file(path, 64);
  const auto end = text ? epoch_from_text(*text) : std::nullopt;
  if (!end)
    log(sink, LogLevel::kWarning, path + " holds no whole number: epochs go on 1,024 above the seconds since 2026");
  return end ? *end : epochs_end_by_time(unix_now_s());
}

/// Of the interface that leads elsewhere, else of loopback. Sends nothing.
asio::ip::address own_address() {
  asio::io_context io;
  asio::ip::udp::socket socket(io, asio::ip::udp::v4());
  ErrorOf none;
  socket.connect({asio::ip::make_address("192.0.2.1"), 9}, none);
  const auto own = socket.local_endpoint(none).address();
  return own.is_unspecified() ? asio::ip::address_v4::loopback() : own;
}

void send_bye_to_all(Context& loop, std::uint32_t spread_ms) {
  std::minstd_rand random(std::random_device{}());
  std::uniform_int_distribution<std::uint32_t> later(0, spread_ms);
  const Connections open = loop.connections;  // A connection with nothing to send may close within the call.
  for (const auto& [id, connection] : open) {
    connection->send_bye("the broker is stopping", kRestartRetryMs + later(random),
                         websocket::CloseCode::kServiceRestart);
  }
}

}  // namespace

Result<Broker::Security> Broker::load_security(const Config& config) {
  Config possible = config;
  possible.limits.max_connections = std::min(config.limits.max_connections, connections_by_descriptors());
  auto policy = AccessPolicy::from_config(possible);
  if (!policy) return policy.error();
  auto tls = make_tls_context(config);
  if (!tls) return tls.error();
  return Security{std::move(*policy), std::move(*tls)};
}

Result<std::unique_ptr<Broker>> Broker::create(const Config& config, std::string version, LogSink log,
                                               const InheritedSockets& inherited) {
  std::signal(SIGPIPE, SIG_IGN);  // OpenSSL writes to sockets without asking for silence.
  auto security = load_security(config);
  if (!security) return security.error();
  const std::string folder = data_dir_of(config);
  AssetStore::Settings settings;
  settings.max_object_bytes = static_cast<std::uint64_t>(config.assets.max_object_bytes);
  settings.max_total_bytes = static_cast<std::uint64_t>(config.assets.max_total_bytes);
  settings.max_objects = static_cast<std::uint64_t>(config.assets.max_objects);
  auto assets = AssetStore::open(folder, settings);
  if (!assets) return assets.error();
  for (const auto& [name, streams] : {std::pair("recording.streams", config.recording.streams),
                                      std::pair("history.streams", config.history.streams)}) {
    if (auto patterns = StreamPatterns::from(streams); !patterns) return in_context(name, patterns.error());
  }
  const std::uint32_t epochs_end = read_epochs_end(folder + "/epoch", log);
  const std::string id = random_id();
  std::unique_ptr<Member> member;
  if (!config.backbone.servers.empty()) {
    if (const auto good = store(member, Member::create(config, id, **assets, log)); !good) return good.error();
  }
  std::unique_ptr<Broker> broker(new Broker(config, std::move(*security), std::move(version), std::move(log),
                                            std::move(*assets), epochs_end, id, std::move(member)));
  if (auto listening = broker->listen(inherited); !listening) return listening.error();
  return broker;
}

Broker::Broker(const Config& config, Security security, std::string version, LogSink log,
               std::unique_ptr<AssetStore> assets, std::uint32_t epochs_end, std::string id,
               std::unique_ptr<Member> member)
    : gate_(std::move(security.policy)),
      tls_(std::move(security.tls)),
      assets_(std::move(assets)),
      recorder_(recorder_settings(config, version), *assets_, log),
      history_(history_settings(config, version), *assets_, log),
      epochs_(epochs_end, [this](std::uint32_t end) { reserve_epochs(end); }),
      alone_([this] { return epochs_.next(unix_now_s()); }),
      member_(std::move(member)),
      disk_(kDiskThreads),
      loops_(config,
             {disk_, commits_, past_, gate_, *assets_, recorder_, history_,
              member_ ? static_cast<Ownership&>(member_->backbone()) : alone_, member_ ? &member_->backbone() : nullptr,
              log, std::move(version), std::move(id)},
             taps()),
      tick_(loop().get_executor()),
      deadline_(loop().get_executor()),
      watchdog_(loop().get_executor()),
      data_listener_(loop(), log, [this](Socket socket) { accept(std::move(socket)); }),
      admin_listener_(loop(), log,
                      [this](Socket socket) { serve_admin(context(), std::move(socket), admin_connections_); }) {
  warn_about_security();
}

std::vector<StreamTap*> Broker::taps() {
  std::vector<StreamTap*> taps{assets_.get(), &recorder_};
  if (history_.kept) taps.push_back(history_.kept.get());
  if (member_) taps.push_back(&member_->backbone());
  return taps;
}

Broker::~Broker() {
  signals_.reset();
  if (member_) member_->stop();
  data_listener_.close();
  admin_listener_.close();
  disk_.join();
  commits_.join();
  past_.join();
  background_.join();
}

Result<void> Broker::listen(const InheritedSockets& inherited) {
  const auto data = parse_address(config().server.listen);
  if (!data) return data.error();
  if (auto opened = inherited.data >= 0 ? data_listener_.adopt(inherited.data) : data_listener_.open(*data); !opened) {
    return opened;
  }
  if (inherited.admin >= 0) return admin_listener_.adopt(inherited.admin);
  if (config().server.admin_listen.empty()) return {};
  const auto admin = parse_address(config().server.admin_listen);
  if (!admin) return admin.error();
  const bool by_default = config().server.admin_listen == Config{}.server.admin_listen;
  if (by_default && data->port == 0) return {};
  return admin_listener_.open(*admin);
}

std::string Broker::page_url() const {
  const auto listen = parse_address(config().server.listen);
  if (!has_page(config()) || !listen) return {};
  auto address = asio::ip::make_address(listen->host);
  if (address.is_unspecified()) address = own_address();
  const std::string host = address.is_v6() ? "[" + address.to_string() + "]" : address.to_string();
  return (tls_ ? "https://" : "http://") + host + ":" + std::to_string(port()) + "/";
}

void Broker::accept(Socket socket) {
  serve_data(context(), tls_ ? Transport(std::move(socket), tls_) : Transport(std::move(socket)));
}

void Broker::run() {
  loops_.first().begin();
  context().drain = [this] { stop(); };
  if (member_) {
    const auto replaces = [this] { return config().streams.second_sender == "replace"; };
    const auto remembers = [this] { return config().memory.enabled; };
    member_->start({loop(), background_, epochs_, loops_.first().hub(), context().memory_reads, replaces, remembers,
                    [this] { context().turn.arm(); }});
  }
  tick();
  watch();
  loops_.start();
  service_manager::notify("READY=1\nSTATUS=" + status());
  loops_.first().run();
  loops_.stop();
}

void Broker::tick() {
  run_after(tick_, std::chrono::seconds(1), [this] { tick(); });
  epochs_.reserve_ahead(unix_now_s());
  check_disk();
  loops_.tick();
  if (!std::exchange(noting_, true)) {
    asio::post(background_, [this] {
      assets_->note_uses();
      asio::post(loop(), [this] { noting_ = false; });
    });
  }
  if (++ticks_ % 10 == 0) service_manager::notify("STATUS=" + status());
}

void Broker::reserve_epochs(std::uint32_t end) {
  const auto write = [assets = assets_.get(), path = data_dir_of(config()) + "/epoch", end] {
    const auto ready = assets->make_writable();
    return ready ? write_file_atomically(path, std::to_string(end) + "\n", true) : ready;
  };
  if (ticks_ == 0) return note_disk(write());  // Nobody is served yet.
  disk_.post({}, [this, write] { asio::post(loop(), [this, written = write()] { note_disk(written); }); });
}

void Broker::note_disk(const Result<void>& written) {
  epochs_.reserved(written.has_value());
  reserved_ = written;
  check_disk();
}

void Broker::check_disk() {
  const bool keeps = !history_.kept || history_.kept->totals().failing == 0;
  const bool fails = !reserved_ || !keeps || assets_->fails();
  if (std::exchange(context().disk_fails, fails) == fails) return;
  const std::string why = !reserved_ ? reserved_.error().message
                          : !keeps   ? "the history takes no frames"
                                     : "the folder of assets takes no files";
  log(context().log, fails ? LogLevel::kError : LogLevel::kInfo,
      fails ? why + "; senders go on, uploads and recordings fail" : "the data folder takes files again");
}

std::string Broker::status() const {
  return std::to_string(loops_.first().context().hub.size()) + " streams, " + std::to_string(websockets()) +
         " connections" + (member_ ? ", " + member_->backbone().status() : std::string());
}

/// Notifies the watchdog through every loop, so that a blocked loop stops the notifications.
void Broker::watch() {
  const auto period_us = service_manager::watchdog_us();
  if (!period_us) return;
  const auto done = [this, period_us] {
    service_manager::notify("WATCHDOG=1");
    run_after(watchdog_, std::chrono::microseconds(*period_us / 3), [this] { watch(); });
  };
  loops_.for_each_loop([](Context&) {}, done);
}

void Broker::handle_signals(std::function<Result<Config>()> load) {
  // A second set keeps SIGHUP handled during shutdown: with its last set Asio restores the default action.
  static auto* const kept = new asio::signal_set(*new asio::io_context, SIGHUP);
  (void)kept;
  load_ = std::move(load);
  signals_.emplace(loop(), SIGINT, SIGTERM, SIGHUP);
  wait_for_signal();
}

void Broker::wait_for_signal() {
  signals_->async_wait([this](ErrorOf error, int signal) {
    if (error) return;
    wait_for_signal();  // First, so that the next signal is handled even if this handler throws.
    if (signal == SIGHUP) return reload(load_());
    stop();
  });
}

void Broker::reload(const Result<Config>& wanted) {
  service_manager::notify("RELOADING=1\nMONOTONIC_USEC=" + std::to_string(steady_now_us()));
  apply(wanted);
  service_manager::notify("READY=1\nSTATUS=" + status());
}

void Broker::apply(const Result<Config>& wanted) {
  if (!wanted) {
    ++context().counters.reloads_failed;
    return log(context().log, LogLevel::kError,
               "the configuration is not reloaded, everything stays as it was: " + wanted.error().message);
  }
  auto security = load_security(*wanted);
  if (!security) return apply(security.error());
  const auto next = std::make_shared<const Config>(reloaded(config(), *wanted));
  if (auto good = check_config(*next); !good)
    return apply(in_context("with what only a restart changes", good.error()));
  const auto changes = changes_between(config(), *wanted);
  for (const ConfigChange& change : changes) {
    log(context().log, change.live ? LogLevel::kInfo : LogLevel::kWarning,
        change.path + " = " + change.after + " instead of " + change.before +
            (change.live ? "" : ": needs a restart, the old value stays until then"));
  }
  loops_.for_each_loop([next](Context& each) { each.config = *next; }, [] {});
  gate_.replace_policy(std::move(security->policy));
  tls_ = std::move(security->tls);
  warn_about_security();
  ++context().counters.reloads;
  log(context().log, LogLevel::kInfo,
      "the configuration is reloaded, " + std::to_string(changes.size()) + " settings differ");
}

void Broker::warn_about_security() {
  const auto listen = parse_address(config().server.listen);
  if (tls_) {
    const std::int64_t left_s = certificate_expires_s(tls_.get()) - std::time(nullptr);
    const std::string when = left_s < 0 ? "has expired" : "expires in " + std::to_string(left_s / 86'400) + " days";
    if (left_s < kShortCertificateS) {
      log(context().log, LogLevel::kWarning, "the certificate " + config().tls.certificate + " " + when);
    }
  } else if (listen && !listen->loopback && gate_.policy()->has_tokens() && config().proxy.trusted.empty()) {
    log(context().log, LogLevel::kWarning,
        "tokens travel unencrypted: set tls.certificate and tls.key, or put a proxy in front and name it in "
        "proxy.trusted");
  }
}

void Broker::stop() {
  asio::post(loop(), [this] {
    if (context().draining) return loop().stop();
    drain();
  });
}

std::uint64_t Broker::websockets() const {
  return loops_.first().context().connections.size() + loops_.connections_of_others();
}

void Broker::drain() {
  context().draining = true;
  log(context().log, LogLevel::kInfo,
      "stopping: " + std::to_string(websockets()) + " connections are asked to reconnect");
  service_manager::notify("STOPPING=1");
  data_listener_.close();
  const std::chrono::milliseconds within(config().timeouts.shutdown_ms);
  const auto until = std::chrono::steady_clock::now() + within * 3 / 4;  // The rest is for what is recorded.
  const TimeUs end_us = steady_now_us() + std::chrono::microseconds(within).count();
  recorder_.end_by(end_us);
  if (history_.kept) history_.kept->end_by(end_us);
  if (member_) member_->stop();
  const auto spread_ms =
      static_cast<std::uint32_t>(std::clamp<std::uint64_t>(websockets() * 1000 / kReturnsPerSecond, 200, 30'000));
  loops_.for_each_loop([spread_ms](Context& each) { send_bye_to_all(each, spread_ms); }, [] {});
  wait_for_peers(until);
}

void Broker::wait_for_peers(std::chrono::steady_clock::time_point until) {
  const Counters& counters = context().counters;
  const bool empty = websockets() == 0 && counters.uploads_now + counters.downloads_now + counters.answers_now == 0;
  if (empty || std::chrono::steady_clock::now() >= until) return loop().stop();
  run_after(deadline_, std::chrono::milliseconds(20), [this, until] { wait_for_peers(until); });
}

}  // namespace eigencast::broker
