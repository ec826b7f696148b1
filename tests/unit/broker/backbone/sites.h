// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/backbone/backbone.h"
#include "tests/unit/broker/backbone/fake_network.h"
#include "tests/unit/broker/support.h"

/// Several brokers as far as the backbone is concerned, on a network and a clock of the test's own.
namespace eigencast::broker::testing {

/// One broker: streams, a store in a folder, and no sockets.
class Site {
 public:
  /// `now`, `replaces`: asked whenever it matters.
  Site(FakeNetwork& network, const TimeUs& now, std::string id, const bool& replaces);
  ~Site();

  /// Stores an object.
  Sha256 put(const Bytes& bytes);

  FakeLink link;
  std::unique_ptr<AssetStore> store;
  std::unique_ptr<AssetExchange> exchange;
  std::unique_ptr<Backbone> backbone;
  std::unique_ptr<Hub> hub;
  bool reads_memories = true;  ///< At once; else they wait here, by holder.
  std::vector<std::pair<std::string, FairReads::Read>> reads{};

 private:
  Backbone::Environment environment();

  const TimeUs& now_;
  const bool& replaces_;
  std::string folder_;
  std::uint32_t last_epoch_ = 0;
};

/// A sender at a site: what broker/connections/publisher does, without the connection.
struct SiteSender : FakeSender {
  void on_replaced() override { replaced = true; }
  /// `replace`: the one that is there.
  void publish(Site& site, const std::string& name, const Sha256& asset, const Resume& resume = {},
               bool replace = false);
  /// REQUIRES: it has the stream.
  void announce(Site& site, const Sha256& asset, const Resume& resume = {});
  void leave() { stream->release(*this); }

  Stream* stream = nullptr;
  Result<void> claimed;
  std::optional<Result<std::uint32_t>> granted;
  bool replaced = false;
};

/// Two brokers, a and b, and more on demand.
class BackboneTest : public ::testing::Test {
 protected:
  void SetUp() override;

  void add_site(const std::string& id) { sites.push_back(std::make_unique<Site>(network, now, id, replaces)); }
  Site& a() { return *sites[0]; }
  Site& b() { return *sites[1]; }
  void pass(TimeUs duration);

  SiteSender& new_sender() { return senders_.emplace_back(); }
  FakeReceiver& new_viewer() { return viewers_.emplace_back(); }
  /// Makes a stream of `site` that sends, with an asset of two objects.
  void publish(SiteSender& sender, Site& site, const std::string& name = "s");
  /// One key of the sender, everywhere.
  void send(SiteSender& sender);
  static void watch(Site& site, FakeReceiver& viewer, const std::string& name = "s");
  static Bytes content(std::uint8_t fill, std::size_t size) { return Bytes(size, fill); }

  bool replaces = false;  ///< Second senders replace first ones, at all brokers.
  TimeUs now = 1'000'000'000, capture = 0;
  Sha256 asset;
  FakeNetwork network;

 private:
  // Streams know them to their end.
  std::deque<SiteSender> senders_;
  std::deque<FakeReceiver> viewers_;

 protected:
  std::vector<std::unique_ptr<Site>> sites;
};

}  // namespace eigencast::broker::testing
