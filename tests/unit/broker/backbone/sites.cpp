// SPDX-License-Identifier: MIT
#include "tests/unit/broker/backbone/sites.h"

#include <unistd.h>

#include <filesystem>
#include <utility>

namespace eigencast::broker::testing {

namespace fs = std::filesystem;

Site::Site(FakeNetwork& network, const TimeUs& now, std::string id, const bool& replaces)
    : link(network), now_(now), replaces_(replaces) {
  std::string pattern = (fs::temp_directory_path() / "eigencast-backbone-XXXXXX").string();
  folder_ = ::mkdtemp(pattern.data());
  store = AssetStore::open(folder_, {}).value();
  const auto at_once = [](const std::function<void()>& work) { work(); };
  exchange = std::make_unique<AssetExchange>(link, *store, "test", at_once, at_once);
  Backbone::Settings settings;
  settings.id = std::move(id);
  settings.prefix = "test";
  backbone = std::make_unique<Backbone>(settings, link, *exchange, environment());
  Hub::Settings hub_settings;
  hub_settings.stream.max_bytes = 64 << 20;
  hub_settings.stream.taps = {store.get(), backbone.get()};
  hub = std::make_unique<Hub>(hub_settings);
  backbone->start(*hub);
}

Backbone::Environment Site::environment() {
  Backbone::Environment around;
  around.now_us = [this] { return now_; };
  around.next_epoch = [this](std::uint32_t above) -> Result<std::uint32_t> {
    return last_epoch_ = std::max(above, last_epoch_) + 1;
  };
  around.note_epoch = [this](std::uint32_t seen) {
    if (seen < 1'000'000) last_epoch_ = std::max(last_epoch_, seen);  // As EpochSource.
  };
  around.replaces = [this] { return replaces_; };
  around.remembers = [] { return true; };
  around.read_memory = [this](const std::string& holder, const FairReads::Read& read) {
    if (!reads_memories) {
      reads.emplace_back(holder, read);
    } else if (read.wanted()) {
      read.load();
      read.then();
    }
    return true;
  };
  around.frames_came = [this] { hub->deliver(); };
  return around;
}

Site::~Site() {
  backbone->stop();
  hub.reset();
  backbone.reset();
  exchange.reset();
  store.reset();
  fs::remove_all(folder_);
}

Sha256 Site::put(const Bytes& bytes) {
  const Sha256 id = sha256(bytes);
  auto upload = store->begin_upload(id).value();
  EXPECT_TRUE(upload->write(bytes));
  EXPECT_TRUE(upload->commit());
  return id;
}

void SiteSender::publish(Site& site, const std::string& name, const Sha256& asset, const Resume& resume, bool replace) {
  stream = site.hub->open(name).value();
  claimed = stream->claim(*this, replace);
  if (claimed) announce(site, asset, resume);
}

void SiteSender::announce(Site& site, const Sha256& asset, const Resume& resume) {
  control::Announce announce = small_announce();
  announce.asset = asset.hex();
  const auto begin = [this, announce, resume](const Result<std::uint32_t>& epoch) {
    granted = epoch;
    if (replaced) return;
    if (!epoch) return stream->release(*this);
    begin_anew();
    EXPECT_GT(*epoch, stream->epoch());
    EXPECT_TRUE(stream->announce(announce, *epoch, resume.issued));
  };
  site.backbone->claim(stream->name(), announce, resume, begin);
}

void BackboneTest::SetUp() {
  add_site("a");
  add_site("b");
  pass(100'000);
}

void BackboneTest::pass(TimeUs duration) {
  for (const TimeUs until = now + duration; now < until;) {
    now += 25'000;
    for (const auto& site : sites) site->backbone->tick();
    network.run();
  }
}

void BackboneTest::publish(SiteSender& sender, Site& site, const std::string& name) {
  const Sha256 chunk = site.put(content(1, 700'000));
  asset = site.put(manifest_of({chunk}));
  sender.publish(site, name, asset);
  network.run();
  ASSERT_TRUE(sender.granted.has_value());
  ASSERT_TRUE(*sender.granted) << sender.granted->error().message;
  send(sender);
}

void BackboneTest::send(SiteSender& sender) {
  capture += 33'333;
  sender.tag = sender.stream->tag();
  ASSERT_TRUE(sender.stream->add_frame(sender.next(capture), now));
  network.run();
}

void BackboneTest::watch(Site& site, FakeReceiver& viewer, const std::string& name) {
  Stream* stream = site.hub->open(name).value();
  ASSERT_TRUE(stream->watch(viewer, Profile{Profile::Rate::kRaw}));
  if (const FramePtr join = stream->join_for(viewer)) viewer.decode(*join);
}

}  // namespace eigencast::broker::testing
