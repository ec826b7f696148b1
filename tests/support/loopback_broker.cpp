// SPDX-License-Identifier: MIT
#include "tests/support/loopback_broker.h"

#include <filesystem>
#include <stdexcept>
#include <thread>

#include "broker/broker.h"

namespace eigencast::testing {

struct LoopbackBroker::Running {
  std::unique_ptr<broker::Broker> broker;
  std::thread thread;
};

LoopbackBroker::LoopbackBroker(int max_streams_per_connection)
    : max_streams_per_connection_(max_streams_per_connection) {
  start();
}
LoopbackBroker::~LoopbackBroker() {
  stop();
}

void LoopbackBroker::start() {
  if (running_) return;
  broker::Config config;
  config.server.listen = "127.0.0.1:" + std::to_string(port_);
  config.server.admin_listen.clear();  // None.
  config.limits.max_streams_per_connection = max_streams_per_connection_;
  config.server.data_dir = folder_.file("data");
  auto made = broker::Broker::create(config, "test", {});
  if (!made) throw std::runtime_error(made.error().message);
  running_ = std::make_unique<Running>();
  running_->broker = std::move(*made);
  port_ = running_->broker->port();
  running_->thread = std::thread([b = running_->broker.get()] { b->run(); });
}

void LoopbackBroker::stop() {
  if (!running_) return;
  running_->broker->stop();
  running_->thread.join();
  running_.reset();
}

void LoopbackBroker::forget_assets() {
  std::filesystem::remove_all(folder_.file("data") + "/assets");
}

}  // namespace eigencast::testing
