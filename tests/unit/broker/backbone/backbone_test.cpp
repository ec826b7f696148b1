// SPDX-License-Identifier: MIT
#include "broker/backbone/backbone.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "tests/unit/broker/backbone/fake_network.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;
using testing::FakeLink;
using testing::FakeNetwork;
using testing::FakeReceiver;
using testing::FakeSender;
using State = control::StreamInfo::State;

constexpr TimeUs kStart = 1'000'000'000;
const Profile kRaw{Profile::Rate::kRaw};

Bytes content(std::uint8_t fill, std::size_t size) {
  return Bytes(size, fill);
}

/// One broker as far as the backbone is concerned: streams, a store, and no network.
class Site {
 public:
  Site(FakeNetwork& network, TimeUs& now, std::string id, bool replace)
      : id_(id), link(network), now_(now), replace_(replace) {
    std::string pattern = (fs::temp_directory_path() / "eigencast-backbone-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
    store = AssetStore::open(folder_, {}).value();
    const auto at_once = [](const std::function<void()>& work) { work(); };
    exchange = std::make_unique<AssetExchange>(link, *store, "test", at_once, at_once);
    Backbone::Settings settings;
    settings.id = id;
    settings.prefix = "test";
    Backbone::Surroundings around;
    around.now_us = [this] { return now_; };
    around.next_epoch = [this](std::uint32_t above) -> Result<std::uint32_t> {
      return last_epoch_ = std::max(above, last_epoch_) + 1;
    };
    around.replaces = [this] { return replace_; };
    around.frames_came = [] {};
    backbone = std::make_unique<Backbone>(settings, link, *exchange, around);
    Hub::Settings hub_settings;
    hub_settings.stream.taps = {store.get(), backbone.get()};
    hub = std::make_unique<Hub>(hub_settings);
    backbone->start(*hub);
  }
  ~Site() {
    backbone->stop();
    hub.reset();
    backbone.reset();
    exchange.reset();
    store.reset();
    fs::remove_all(folder_);
  }

  Sha256 put(const Bytes& bytes) {
    const Sha256 id = sha256(bytes);
    auto upload = store->begin_upload(id).value();
    EXPECT_TRUE(upload->write(bytes));
    EXPECT_TRUE(upload->commit());
    return id;
  }

  std::string id_;
  FakeLink link;
  std::unique_ptr<AssetStore> store;
  std::unique_ptr<AssetExchange> exchange;
  std::unique_ptr<Backbone> backbone;
  std::unique_ptr<Hub> hub;

 private:
  TimeUs& now_;
  bool replace_;
  std::string folder_;
  std::uint32_t last_epoch_ = 0;
};

/// A sender at a site: what broker/connections/publisher does, without the connection.
struct Sender : FakeSender {
  void on_replaced() override { replaced = true; }
  void publish(Site& site, const std::string& name, const Sha256& asset) {
    stream = site.hub->open(name).value();
    claimed = stream->claim(*this);
    if (!claimed) return;
    control::Announce announce = testing::small_announce();
    announce.asset = asset.hex();
    site.backbone->claim(name, announce, [this, announce](const Result<std::uint32_t>& epoch) {
      granted = epoch;
      if (!epoch) return stream->release(*this);
      begin_anew();
      EXPECT_TRUE(stream->announce(announce, *epoch));
    });
  }
  void leave() { stream->release(*this); }
  Stream* stream = nullptr;
  Result<void> claimed;
  std::optional<Result<std::uint32_t>> granted;
  bool replaced = false;
};

class BackboneTest : public ::testing::Test {
 protected:
  void add_site(const std::string& id) { sites.push_back(std::make_unique<Site>(network, now, id, replace)); }
  void SetUp() override {
    add_site("a");
    add_site("b");
    pass(100'000);
  }
  void pass(TimeUs duration) {
    for (const TimeUs until = now + duration; now < until;) {
      now += 25'000;
      for (const auto& site : sites) site->backbone->tick();
      network.run();
    }
  }
  /// One key of the sender, everywhere.
  void send(Sender& sender) {
    capture += 33'333;
    ASSERT_TRUE(sender.stream->add_frame(sender.next(capture), now));
    network.run();
  }
  Site& a() { return *sites[0]; }
  Site& b() { return *sites[1]; }
  /// A stream of `site` that sends.
  void publish(Sender& sender, Site& site, const std::string& name = "s") {
    const Sha256 chunk = site.put(content(1, 700'000));
    Bytes manifest = content(2, 100);
    ByteWriter(manifest).bytes(chunk.digest);
    asset = site.put(manifest);
    sender.publish(site, name, asset);
    network.run();
    ASSERT_TRUE(sender.granted.has_value());
    ASSERT_TRUE(*sender.granted) << sender.granted->error().message;
    send(sender);
  }
  void watch(Site& site, FakeReceiver& viewer, const std::string& name = "s") {
    Stream* stream = site.hub->open(name).value();
    ASSERT_TRUE(stream->watch(viewer, kRaw));
    if (const FramePtr join = stream->join_for(viewer)) viewer.decode(*join);
  }

  Sender& new_sender() { return senders_.emplace_back(); }
  FakeReceiver& new_viewer() { return viewers_.emplace_back(); }

  bool replace = false;
  TimeUs now = kStart, capture = 0;
  Sha256 asset;
  FakeNetwork network;

 private:
  // Streams know them to their end.
  std::deque<Sender> senders_;
  std::deque<FakeReceiver> viewers_;

 protected:
  std::vector<std::unique_ptr<Site>> sites;
};

TEST_F(BackboneTest, AStreamOfOneBrokerIsSeenAtAnother) {
  Sender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& here = new_viewer();
  FakeReceiver& there = new_viewer();
  watch(a(), here);
  watch(b(), there);
  pass(50'000);
  for (int i = 0; i < 20; ++i) send(sender);
  ASSERT_EQ(there.infos.back().state, State::kLive);
  EXPECT_EQ(there.infos.back().epoch, here.infos.back().epoch);
  EXPECT_EQ(there.infos.back().asset, asset.hex());
  EXPECT_TRUE(b().store->contains(asset)) << "viewers download from their own broker";
  EXPECT_EQ(b().store->objects(), 2U);
  EXPECT_EQ(here.undecodable + there.undecodable, 0);
  // The join stands for the key before.
  ASSERT_GE(there.poses.size(), 20U);
  const std::size_t more = here.poses.size() - 20;
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_EQ(there.poses[there.poses.size() - 20 + i].key, here.poses[more + i].key);
  }
}

TEST_F(BackboneTest, NothingIsFollowedThatNobodyWatches) {
  Sender& sender = new_sender();
  publish(sender, a());
  pass(1'000'000);
  EXPECT_EQ(b().backbone->totals().streams_followed, 0U);
  EXPECT_EQ(b().backbone->totals().streams_known, 1U);
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  EXPECT_EQ(b().backbone->totals().streams_followed, 1U);
  b().hub->find("s")->unwatch(viewer);
  pass(4'000'000);
  EXPECT_EQ(b().backbone->totals().streams_followed, 1U) << "it may come back";
  pass(2'000'000);
  EXPECT_EQ(b().backbone->totals().streams_followed, 0U);
  const std::uint64_t followed = b().backbone->totals().frames_followed;
  send(sender);
  EXPECT_EQ(b().backbone->totals().frames_followed, followed);
  // And again, in the same epoch.
  watch(b(), viewer);
  pass(100'000);
  send(sender);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().key, testing::key_number(2));
}

TEST_F(BackboneTest, TheAssetComesOncePerBroker) {
  Sender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& one = new_viewer();
  FakeReceiver& two = new_viewer();
  watch(b(), one);
  watch(b(), two);
  pass(100'000);
  EXPECT_EQ(b().backbone->totals().asset_bytes_fetched, 700'000U + 132U);
}

TEST_F(BackboneTest, LostFramesCostAJoinAndNothingElse) {
  Sender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  for (int i = 0; i < 200; ++i) {
    network.drops = [&](const std::string& subject) { return i % 7 == 3 && subject == "test.frames.s"; };
    send(sender);
    pass(25'000);
  }
  network.drops = {};
  send(sender);
  pass(100'000);
  EXPECT_EQ(viewer.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().envelope.sequence, 201U);
  EXPECT_GT(b().backbone->totals().joins_asked, 20U);
  for (std::size_t i = 1; i < viewer.poses.size(); ++i) {
    EXPECT_LT(viewer.poses[i - 1].envelope.sequence, viewer.poses[i].envelope.sequence);
  }
}

TEST_F(BackboneTest, ASecondSenderAtAnotherBrokerIsRefused) {
  Sender& first = new_sender();
  Sender& second = new_sender();
  publish(first, a());
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  ASSERT_TRUE(second.granted.has_value());
  EXPECT_EQ(second.granted->error().code, ErrorCode::kRefused);
  EXPECT_EQ(b().backbone->totals().claims_refused, 1U);
  EXPECT_FALSE(first.replaced);
}

TEST_F(BackboneTest, OfTwoAtOnceOneIsRefused) {
  const Sha256 in_a = a().put(content(9, 10)), in_b = b().put(content(9, 10));
  Sender& first = new_sender();
  Sender& second = new_sender();
  first.publish(a(), "s", in_a);
  second.publish(b(), "s", in_b);  // Neither knows of the other: both write.
  network.run();
  pass(500'000);
  ASSERT_TRUE(first.granted && second.granted);
  EXPECT_NE(first.granted->has_value(), second.granted->has_value());
  const Result<std::uint32_t>& loser = *first.granted ? *second.granted : *first.granted;
  EXPECT_EQ(loser.error().code, ErrorCode::kRefused);
}

TEST_F(BackboneTest, ASenderMovesAndItsViewersGoOn) {
  Sender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  send(sender);
  const std::uint32_t epoch = viewer.infos.back().epoch;
  sender.leave();
  pass(100'000);
  EXPECT_EQ(viewer.infos.back().state, State::kStalled);
  // To the very broker where it was followed.
  Sender& moved = new_sender();
  publish(moved, b());
  ASSERT_TRUE(moved.claimed);
  pass(100'000);
  send(moved);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_GT(viewer.infos.back().epoch, epoch);
  EXPECT_EQ(viewer.undecodable, 0);
  // And back.
  FakeReceiver& other = new_viewer();
  watch(a(), other);
  pass(100'000);
  EXPECT_EQ(other.infos.back().state, State::kLive);
  moved.leave();
  pass(100'000);
  Sender& back = new_sender();
  publish(back, a());
  pass(100'000);
  send(back);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable + other.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().key, other.poses.back().key);
}

TEST_F(BackboneTest, ARefusedSenderLeavesTheFollowedStreamAsItWas) {
  Sender& first = new_sender();
  publish(first, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  send(first);
  Sender& second = new_sender();
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  EXPECT_TRUE(second.claimed) << "the follower yields until the directory has spoken";
  EXPECT_FALSE(*second.granted);
  pass(200'000);
  send(first);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().envelope.sequence, 2U);
}

TEST_F(BackboneTest, ADeadBrokersStreamMayBeTakenOver) {
  Sender& first = new_sender();
  Sender& second = new_sender();
  publish(first, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(6'000'000);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  a().link.cut();  // No word of goodbye.
  pass(1'000'000);
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  EXPECT_FALSE(*second.granted) << "too early";
  pass(Directory::kSilenceUs);
  Sender& third = new_sender();
  publish(third, b());
  send(third);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(BackboneTest, WithoutAConnectionLocalStreamsGoOnAndNewOnesBegin) {
  Sender& sender = new_sender();
  Sender& another = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  FakeReceiver& other = new_viewer();
  watch(a(), viewer);
  a().link.cut();
  pass(1'000'000);
  send(sender);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.poses.back().envelope.sequence, 1U);
  EXPECT_FALSE(a().backbone->totals().connected);
  publish(another, a(), "t");
  watch(a(), other, "t");
  send(another);
  EXPECT_EQ(other.infos.back().state, State::kLive);
  // Back: what began meanwhile is known to all.
  a().link.connect();
  pass(1'000'000);
  FakeReceiver& far = new_viewer();
  watch(b(), far, "t");
  pass(200'000);
  send(another);
  EXPECT_EQ(far.infos.back().state, State::kLive);
  EXPECT_EQ(far.poses.back().key, other.poses.back().key);
}

TEST_F(BackboneTest, WhenBrokersMeetAgainOneSenderStays) {
  Sender& first = new_sender();
  Sender& second = new_sender();
  publish(first, a());
  a().link.cut();
  pass(7'000'000);
  publish(second, b());
  FakeReceiver& at_a = new_viewer();
  FakeReceiver& at_b = new_viewer();
  watch(a(), at_a);
  watch(b(), at_b);
  send(first);
  send(second);
  ASSERT_NE(at_a.infos.back().epoch, at_b.infos.back().epoch);
  a().link.connect();
  pass(1'000'000);
  EXPECT_NE(first.replaced, second.replaced);
  EXPECT_TRUE(first.replaced) << "the later one stays";
  pass(100'000);
  send(second);
  EXPECT_EQ(at_a.infos.back().epoch, at_b.infos.back().epoch);
  EXPECT_EQ(at_a.poses.back().key, at_b.poses.back().key);
  EXPECT_EQ(at_a.undecodable + at_b.undecodable, 0);
}

TEST_F(BackboneTest, ATableThatDoesNotAnswerIsDoneWithoutAfterAWhile) {
  network.table_answers = false;
  Sender& sender = new_sender();
  sender.publish(a(), "s", a().put(content(9, 10)));
  pass(5'000'000);
  EXPECT_FALSE(sender.granted.has_value());
  pass(10'000'000);
  ASSERT_TRUE(sender.granted.has_value());
  EXPECT_TRUE(*sender.granted);
  network.table_answers = true;
  pass(2'000'000);
  EXPECT_EQ(b().backbone->totals().streams_known, 1U) << "told as soon as it can be";
}

TEST_F(BackboneTest, ATableThatItsServersLostIsWrittenAnew) {
  publish(new_sender(), a(), "other");  // The revision of the entry of s is not that of the first of a new table.
  Sender& sender = new_sender();
  publish(sender, a());
  network.lose_table();
  for (const auto& site : sites) site->link.cut();
  pass(100'000);
  for (const auto& site : sites) site->link.connect();
  pass(1'000'000);
  add_site("c");
  pass(100'000);
  FakeReceiver& viewer = new_viewer();
  FakeReceiver& here = new_viewer();
  watch(*sites[2], viewer);
  watch(a(), here);
  pass(100'000);
  send(sender);
  ASSERT_FALSE(viewer.poses.empty());
  EXPECT_EQ(viewer.poses.back().key, here.poses.back().key);
  sender.leave();
  pass(100'000);
  Sender& moved = new_sender();
  publish(moved, b());
  pass(100'000);
  send(moved);
  EXPECT_EQ(viewer.infos.back().epoch, moved.stream->epoch());
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(BackboneTest, InACrowdOnlyBrokersWithStreamsSpeakEachSecond) {
  std::map<std::string, int> signs;
  const auto count = [&signs](const Bytes& message) { ++signs[std::string(message.begin() + 1, message.end())]; };
  FakeLink ear(network);
  const auto listening = ear.subscribe("test.alive", count);
  for (int i = 0; i < 1000; ++i) {
    const std::string other = "+crowd-" + std::to_string(i);
    a().link.publish("test.alive", Bytes(other.begin(), other.end()));
  }
  pass(2'000'000);
  signs.clear();
  Sender& sender = new_sender();
  publish(sender, a());
  EXPECT_EQ(signs["a"], 1) << "before others hear of its stream";
  pass(20'000'000);
  EXPECT_GE(signs["a"], 20);
  EXPECT_LE(signs["b"], 2);
}

TEST_F(BackboneTest, ABrokerThatStopsLeavesItsStreamsFree) {
  Sender& first = new_sender();
  publish(first, a());
  a().backbone->stop();
  network.run();
  Sender& second = new_sender();
  publish(second, b());
}

TEST_F(BackboneTest, AnAssetThatTheOwnerHasNotIsAskedForAgain) {
  Sender& sender = new_sender();
  sender.publish(a(), "s", sha256(content(77, 7)));
  network.run();
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(2'000'000);
  EXPECT_EQ(viewer.infos.back().state, State::kWaiting);
  a().put(content(77, 7));
  pass(1'000'000);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
}

TEST_F(BackboneTest, ThreeBrokersAndManyStreams) {
  add_site("c");
  pass(100'000);
  std::vector<Sender*> senders;
  std::vector<FakeReceiver*> viewers;
  for (int i = 0; i < 12; ++i) {
    const std::string name = "lab." + std::to_string(i) + "/x";
    senders.push_back(&new_sender());
    publish(*senders.back(), *sites[static_cast<std::size_t>(i % 3)], name);
    for (int site = 0; site < 3; ++site) {
      viewers.push_back(&new_viewer());
      watch(*sites[static_cast<std::size_t>(site)], *viewers.back(), name);
    }
  }
  pass(200'000);
  for (int round = 0; round < 5; ++round) {
    for (int i = 0; i < 12; ++i) {
      send(*senders[static_cast<std::size_t>(i)]);
    }
  }
  for (std::size_t v = 0; v < viewers.size(); ++v) {
    EXPECT_EQ(viewers[v]->undecodable, 0);
    EXPECT_EQ(viewers[v]->infos.back().stream, "lab." + std::to_string(v / 3) + "/x");
    EXPECT_EQ(viewers[v]->poses.back().envelope.sequence, 5U);
    EXPECT_EQ(viewers[v]->poses.back().envelope.capture_us, viewers[v - v % 3]->poses.back().envelope.capture_us);
  }
}

}  // namespace
}  // namespace eigencast::broker
