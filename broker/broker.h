// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "broker/backbone/member.h"
#include "broker/config/config.h"
#include "broker/connections/listener.h"
#include "broker/loops.h"
#include "broker/operation/service_manager.h"
#include "broker/relay/epoch_source.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/recorder.h"

namespace eigencast::broker {

/// The whole service in one object: what it is made of, in the order of construction.
///
/// Its event loops are those of Loops, the first run by the caller of run(); stop() may be called from any thread.
class Broker {
 public:
  /// Opens the data folder and listens. Errors: kUnreachable (cannot listen), kRefused and others (data folder).
  /// `given` sockets are used instead of opening some, and owned from then on.
  static Result<std::unique_ptr<Broker>> create(const Config& config, std::string version, LogSink log,
                                                const GivenSockets& given = {});
  ~Broker();
  Broker(const Broker&) = delete;
  Broker& operator=(const Broker&) = delete;

  /// The data port speaks TLS from now on; before run().
  void use_tls(TlsProvider tls) { context().tls = std::move(tls); }

  /// Serves until stop(), then returns when all peers are told, at most timeouts.shutdown_ms later.
  void run();
  /// Begins to stop; called again: now.
  void stop();
  /// What a configuration says about access and encryption, read from its files.
  struct Doors {
    std::shared_ptr<const AccessPolicy> policy;
    std::shared_ptr<SSL_CTX> tls;
  };
  static Result<Doors> load_doors(const Config& config);

  /// Takes over what is reloadable of `wanted` and says what changes and what needs a restart. On the first loop's
  /// thread, or before run().
  void reload(const Result<Config>& wanted);
  /// From now on SIGTERM and SIGINT call stop(), and SIGHUP reloads what `load` gives.
  void obey_signals(std::function<Result<Config>()> load);

  std::uint16_t port() const { return data_listener_.port(); }
  /// 0: off.
  std::uint16_t admin_port() const { return admin_listener_.port(); }

 private:
  Broker(const Config& config, Doors doors, std::string version, LogSink log, std::unique_ptr<AssetStore> assets,
         EpochSource epochs, std::string id, std::unique_ptr<Member> member);
  std::vector<StreamTap*> taps();
  void join_others();
  void apply(const Result<Config>& wanted);
  Result<void> listen(const GivenSockets& given);
  void accept(Socket socket);
  asio::io_context& loop() { return loops_.first().io(); }
  Context& context() { return loops_.first().context(); }
  const Config& config() const { return loops_.first().context().config; }
  void tick();
  void watch();
  std::string status() const;
  /// Open ones, of all loops.
  std::uint64_t websockets() const;
  void warn_about_doors();
  void drain();
  void wait_for_peers(std::chrono::steady_clock::time_point until);

  class Signals;
  Gate gate_;
  std::shared_ptr<SSL_CTX> tls_;  ///< Null: the data port is plain.
  std::unique_ptr<AssetStore> assets_;
  Recorder recorder_;
  EpochSource epochs_;
  SoleOwnership alone_;
  std::unique_ptr<Member> member_;  ///< Null: this broker stands alone.
  asio::thread_pool disk_;
  Loops loops_;  // What waits in them ends with them and needs all above.
  Timer tick_;
  Timer deadline_;
  Timer watchdog_;
  int ticks_ = 0;
  Listener data_listener_;
  Listener admin_listener_;
  std::unique_ptr<Signals> signals_;
};

}  // namespace eigencast::broker
