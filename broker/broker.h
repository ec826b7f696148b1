// SPDX-License-Identifier: MIT
#pragma once

#include <boost/asio/signal_set.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "broker/access/gate.h"
#include "broker/access/tls_context.h"
#include "broker/backbone/member.h"
#include "broker/config/config.h"
#include "broker/loops/loops.h"
#include "broker/operation/service_manager.h"
#include "broker/relay/ownership.h"
#include "broker/sockets/disk_threads.h"
#include "broker/sockets/listener.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/history.h"
#include "broker/storage/recorder.h"

namespace eigencast::broker {

/// The whole service. The caller of run() runs the first event loop; any thread may call stop().
class Broker {
 public:
  /// Opens the data folder and listens. Errors: kUnreachable (cannot listen), kRefused and others (data folder).
  /// Takes over `inherited` sockets instead of opening its own.
  static Result<std::unique_ptr<Broker>> create(const Config& config, std::string version, LogSink log,
                                                const InheritedSockets& inherited = {});
  ~Broker();

  /// Serves until stop(), then says bye to all peers and returns, at most timeouts.shutdown_ms later.
  void run();
  /// Begins to stop; a second call stops at once.
  void stop();
  struct Security {
    std::shared_ptr<const AccessPolicy> policy;
    std::shared_ptr<SSL_CTX> tls;
  };
  static Result<Security> load_security(const Config& config);

  /// Applies the reloadable settings of `wanted` and logs all changes. On the first loop's thread, or before run().
  void reload(const Result<Config>& wanted);
  /// Makes SIGTERM and SIGINT call stop(), and SIGHUP reload the result of `load`.
  void handle_signals(std::function<Result<Config>()> load);

  std::uint16_t port() const { return data_listener_.port(); }
  /// Where browsers find the page; empty: there is none. Of a wildcard address by the one that others reach.
  std::string page_url() const;
  std::uint16_t admin_port() const { return admin_listener_.port(); }  ///< 0: off.

 private:
  Broker(const Config& config, Security security, std::string version, LogSink log, std::unique_ptr<AssetStore> assets,
         std::uint32_t epochs_end, std::string id, std::unique_ptr<Member> member);
  std::vector<StreamTap*> taps();
  void apply(const Result<Config>& wanted);
  Result<void> listen(const InheritedSockets& inherited);
  void accept(Socket socket);
  asio::io_context& loop() { return loops_.first().io(); }
  Context& context() { return loops_.first().context(); }
  const Config& config() const { return loops_.first().context().config; }
  void tick();
  void watch();
  std::string status() const;
  std::uint64_t websockets() const;
  void warn_about_security();
  void reserve_epochs(std::uint32_t end);
  void note_disk(const Result<void>& written);
  void check_disk();
  void drain();
  void wait_for_signal();
  void wait_for_peers(std::chrono::steady_clock::time_point until);

  Gate gate_;
  std::shared_ptr<SSL_CTX> tls_;  ///< Null: the data port is plain. Of new connections: a reload replaces it.
  std::unique_ptr<AssetStore> assets_;
  Recorder recorder_;
  History history_;
  EpochSource epochs_;
  SoleOwnership alone_;
  std::unique_ptr<Member> member_;           ///< Null: no backbone.
  asio::thread_pool background_{1};          ///< Assets for other brokers, uses of assets: clients never wait for it.
  DiskThreads disk_, commits_{1}, past_{1};  ///< As SharedContext's.
  Shares admin_connections_;
  Loops loops_;  // Pending handlers end with the loops and need the members above.
  Timer tick_;
  Timer deadline_;
  Timer watchdog_;
  int ticks_ = 0;
  Result<void> reserved_;  ///< Epochs, on the disk.
  bool noting_ = false;    ///< background_ notes uses of assets.
  Listener data_listener_;
  Listener admin_listener_;
  std::function<Result<Config>()> load_;
  std::optional<asio::signal_set> signals_;
};

}  // namespace eigencast::broker
