// SPDX-License-Identifier: MIT
//
// What viewers at one broker get of a stream that is sent to another.
#include <array>

#include "tests/unit/broker/backbone/sites.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using State = control::StreamInfo::State;

TEST_F(BackboneTest, StreamIsSeenAtOtherBrokers) {
  SiteSender& sender = new_sender();
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

TEST_F(BackboneTest, UnwatchedStreamsAreNotFollowed) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  pass(1'000'000);
  EXPECT_EQ(b().backbone->totals().streams_subscribed, 0U);
  EXPECT_EQ(b().backbone->totals().streams_known, 1U);
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  EXPECT_EQ(b().backbone->totals().streams_subscribed, 1U);
  b().hub->find("s")->unwatch(viewer);
  pass(4'000'000);
  EXPECT_EQ(b().backbone->totals().streams_subscribed, 1U) << "it may come back";
  pass(2'000'000);
  EXPECT_EQ(b().backbone->totals().streams_subscribed, 0U);
  const std::uint64_t followed = b().backbone->totals().frames_followed;
  send(sender);
  EXPECT_EQ(b().backbone->totals().frames_followed, followed);
  // And again, in the same epoch.
  watch(b(), viewer);
  pass(100'000);
  send(sender);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
  EXPECT_EQ(viewer.poses.back().key, key_number(2));
}

TEST_F(BackboneTest, WatchedNamesCostWhatChanges) {
  constexpr std::uint64_t kNames = 10'000, kTicks = 400;
  for (std::uint64_t i = 0; i < kNames; ++i) watch(b(), new_viewer(), "waiting/" + std::to_string(i));
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(1'000'000);
  const auto compared = [&] { return b().backbone->totals().names_compared; };
  const std::uint64_t before = compared();
  pass(kTicks * 25'000);
  EXPECT_LE(compared() - before, kTicks / 40 * (kNames + 1)) << "a sweep a second";
  SiteSender& sender = new_sender();
  publish(sender, a());
  pass(25'000);
  const std::uint64_t began = compared();
  for (int i = 0; i < 10; ++i) {  // Its rows change, and no others.
    sender.stream->release(sender);
    network.run();
    sender.publish(a(), "s", asset);
    network.run();
  }
  EXPECT_LE(compared() - began, 100U);
  pass(50'000);
  EXPECT_EQ(viewer.infos.back().state, State::kLive) << "at once, not at the next sweep";
}

TEST_F(BackboneTest, RefusedSenderLeavesTheStreamToOthersAtOnce) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(1'000'000);
  SiteSender& second = new_sender();
  second.publish(b(), "s", b().put(content(9, 10)));
  network.run();
  ASSERT_TRUE(second.granted && !*second.granted);
  pass(50'000);
  send(sender);
  EXPECT_EQ(viewer.infos.back().state, State::kLive) << "not at the next sweep";
}

TEST_F(BackboneTest, AssetIsFetchedOncePerBroker) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& one = new_viewer();
  FakeReceiver& two = new_viewer();
  watch(b(), one);
  watch(b(), two);
  pass(100'000);
  EXPECT_EQ(b().backbone->totals().asset_bytes_fetched, 700'000U + a().store->read(asset)->size);
}

TEST_F(BackboneTest, AnAssetIsAskedAboutOnceAMinuteWhateverIsAnnounced) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  const auto announce = [&] {
    const int before = network.asked["test.assets.a"];
    sender.announce(a(), asset);
    pass(100'000);
    send(sender);
    EXPECT_EQ(viewer.infos.back().state, State::kLive);
    EXPECT_EQ(viewer.infos.back().epoch, sender.stream->epoch());
    return network.asked["test.assets.a"] - before;
  };
  for (int i = 0; i < 20; ++i) EXPECT_EQ(announce(), 0);
  pass(AssetExchange::kWholeUs);
  EXPECT_EQ(announce(), 1) << "this broker may have evicted what it lists";
  EXPECT_EQ(announce(), 0);
}

TEST_F(BackboneTest, TransfersThatBrokersStartAreFew) {
  FakeLink link(network);
  const auto at_once = [](const std::function<void()>& work) { work(); };
  AssetExchange exchange(link, *a().store, "test", at_once, at_once);
  int refused = 0;
  std::size_t size = 0;
  const auto fetch = [&](const std::string& owner) {
    exchange.fetch(owner, sha256(content(1, ++size)), "payer", now,
                   [&](const Result<void>& done) { refused += !done && done.error().code == ErrorCode::kRefused; });
    return refused;
  };
  for (int i = 0; i < 100; ++i) fetch("evil." + std::to_string(i % 3));
  EXPECT_EQ(std::exchange(refused, 0), 100 - 16) << "whatever its run";
  EXPECT_EQ(fetch("good.1"), 0);
  for (int i = 0; i < 1'000; ++i) fetch("many" + std::to_string(i) + ".1");
  EXPECT_EQ(std::exchange(refused, 0), 1'000 - (256 - 17));
  network.run();  // Nobody answers.
  EXPECT_EQ(fetch("evil.1"), 0);
  network.run();
}

TEST_F(BackboneTest, AFloodOfQuestionsForAssetsWaitsInAShortQueue) {
  FakeLink link(network), evil(network);
  std::vector<std::function<void()>> waiting;
  AssetExchange exchange(
      link, *a().store, "test", [&](std::function<void()> work) { waiting.push_back(std::move(work)); },
      [](const std::function<void()>& work) { work(); });
  exchange.serve("flooded");
  const Sha256 id = a().put(content(1, 10));
  int here = 0, answers = 0;
  const auto ask = [&] {
    Bytes request{'L'};
    ByteWriter(request).bytes(id.digest);
    evil.ask("test.assets.flooded", request, 1'000'000, [&](const Result<Bytes>& answer) {
      ++answers;
      here += answer && *answer == Bytes{0};
    });
  };
  for (int i = 0; i < 1'000; ++i) ask();
  network.run();
  EXPECT_EQ(waiting.size(), AssetExchange::kMaxAnswers);
  EXPECT_EQ(answers, 1'000 - static_cast<int>(AssetExchange::kMaxAnswers)) << "not here, at once";
  EXPECT_EQ(here, 0);
  for (int round = 1; round <= 2; ++round) {
    for (const auto& work : std::exchange(waiting, {})) work();
    network.run();
    EXPECT_EQ(here, round == 1 ? static_cast<int>(AssetExchange::kMaxAnswers) : here);
    ask();
    network.run();
    EXPECT_EQ(waiting.size(), 1U);
  }
  exchange.stop();
  for (const auto& work : waiting) work();
  network.run();
}

/// A broker that says what it likes of a stream with large keys.
struct EvilBroker {
  EvilBroker(FakeNetwork& network, const Sha256& asset) : link(network) {
    listening = {link.serve("test.assets.evil.1", [](const Bytes&, const Link::Reply& reply) { reply({0}); }),
                 link.serve("test.joins.evil.1", [this](const Bytes&, const Link::Reply& reply) {
                   reply(frame(FrameKind::kJoin, {2, 160, 160, 1, 2, 0x9f, 0x9f}));
                 })};
    link.publish("test.alive.evil.1", {'+'});
    entry.announce.asset = asset.hex();
    entry.announce.format = large_announce().format;
  }
  Bytes frame(FrameKind kind, const Bytes& payload) const {
    const auto now = static_cast<TimeUs>(sequence);
    const ChainClock before{sequence - 1, now - 1, 1};
    Bytes message;
    ByteWriter writer(message);
    writer.u32(entry.epoch);
    writer.u64(sequence);
    append_envelope({.kind = kind,
                     .bands = 1,
                     .step = {},
                     .sequence = sequence,
                     .capture_us = now,
                     .age_us = kind == FrameKind::kJoin ? 1 : 0},
                    &before, message);
    writer.bytes(payload);
    return message;
  }
  void key() {
    ++sequence;
    link.publish("test.frames.evil.1.x", frame(FrameKind::kKey, {3, 1, 0xbf}));
  }

  FakeLink link;
  DirectoryEntry entry{"evil.1", 1, true, small_announce(), {}};
  std::uint64_t sequence = 1;
  std::vector<std::shared_ptr<void>> listening;
};

TEST_F(BackboneTest, FramesOfABrokerBeyondItsBudgetAreLeftOut) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  const Sha256 known = b().put(content(3, 10));
  EvilBroker evil(network, known);
  evil.link.publish_row("x", text_from_entry(evil.entry), 1);
  struct : FakeReceiver {
    void on_frames(const Stream&, std::span<const FramePtr>) override {}
  } crowd;
  watch(b(), crowd, "x");
  pass(100'000);
  ASSERT_EQ(crowd.infos.back().state, State::kLive);
  const auto followed = [&] { return b().backbone->totals().frames_followed; };
  const std::uint64_t before = followed();
  for (int i = 0; i < 8'000; ++i) evil.key();
  network.run();
  EXPECT_GT(followed() - before, 200U);
  EXPECT_LT(followed() - before, 1'000U);
  const std::size_t seen = viewer.poses.size();
  for (int i = 0; i < 5; ++i) send(sender);
  EXPECT_EQ(viewer.poses.size(), seen + 5) << "others have a budget of their own";
  pass(2'000'000);
  const std::uint64_t later = followed();
  for (int i = 0; i < 10; ++i) evil.key();
  network.run();
  pass(1'000'000);
  for (int i = 0; i < 10; ++i) evil.key();
  network.run();
  EXPECT_GE(followed() - later, 10U) << "a join, and keys again";
  b().hub->find("x")->unwatch(crowd);
}

/// JetStream answers a request to the subject that it names, past the permissions of who asks: in JSON, or nothing.
TEST_F(BackboneTest, AnswersOfJetStreamAreNoMessagesOfBrokers) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  FakeLink rogue(network);
  const std::string text = R"({"type":"io.nats.jetstream.api.v1.stream_names_response","total":0})";
  const Bytes json(text.begin(), text.end());
  for (const Bytes& said : {json, Bytes(), Bytes{'+', '+'}, Bytes{'-', '-'}, Bytes{'x'}}) {
    rogue.publish("test.alive.c", said);
    rogue.publish("test.alive.a", said);
  }
  network.run();
  EXPECT_EQ(b().backbone->totals().brokers, 2u);
  for (const char* subject : {"test.frames.a.s", "test.frames.a.s.="})
    for (int i = 0; i < 50'000; ++i) rogue.publish(subject, json);
  network.run();
  const std::size_t seen = viewer.poses.size();
  for (int i = 0; i < 5; ++i) send(sender);
  EXPECT_EQ(viewer.poses.size(), seen + 5) << "its sender pays for none of them";
}

/// Counts what it is told, and keeps nothing.
struct CountingViewer : FakeReceiver {
  void on_stream_changed(const Stream&, bool) override { ++told; }
  void on_frames(const Stream&, std::span<const FramePtr>) override {}
  std::uint64_t told = 0;
};

TEST_F(BackboneTest, ViewersAreToldOfChangesInTheTimeOfTheirSender) {
  constexpr int kViewers = 1'000, kRounds = 80, kRows = 5;
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  const std::array assets{b().put(content(3, 10)), b().put(content(4, 10))};
  EvilBroker evil(network, assets[0]);
  evil.entry.sender = "flapping";
  std::uint64_t revision = 0;
  const auto change = [&](const std::string& name) {
    evil.link.publish_row(name, text_from_entry(evil.entry), ++revision);
  };
  change("x");
  std::vector<CountingViewer> crowd(kViewers);
  for (CountingViewer& one : crowd) watch(b(), one, "x");
  pass(300'000);
  const auto told = [&] {
    std::uint64_t sum = 0;
    for (CountingViewer& one : crowd) sum += std::exchange(one.told, 0);
    return sum;
  };
  for (const bool begins : {true, false}) {
    (void)told();
    const std::size_t seen = viewer.poses.size();
    for (int i = 0; i < kRounds * kRows; ++i) {
      if (begins) ++evil.entry.epoch;
      if (!begins) evil.entry.next = assets[static_cast<std::size_t>(i) % 2].hex();
      change("x");
      network.run();
      if (i % kRows != 0) continue;
      evil.link.publish("test.alive.evil.1", {'+'});
      send(sender);
      pass(25'000);
    }
    EXPECT_EQ(viewer.poses.size(), seen + kRounds) << "others miss nothing";
    // Half of a broker's time in these ticks and some, by 10 us a viewer; that a stream stalls is told for the same.
    EXPECT_LE(told(), (begins ? 2 : 1) * std::uint64_t{kRounds + 10} * PeerWork::kChangesUs / 2 / 10) << begins;
    pass(500'000);
    EXPECT_EQ(b().hub->find("x")->epoch(), evil.entry.epoch) << "the last change comes";
    if (begins) continue;
    ASSERT_TRUE(b().hub->find("x")->snapshot().next);
    EXPECT_EQ(b().hub->find("x")->snapshot().next->asset, evil.entry.next);
  }
  for (int i = 0; i < 100; ++i) {
    ++evil.entry.epoch;
    change("x");
    network.run();
    if (i % kRows == 0) pass(25'000);
  }
  evil.entry.sender = "another";
  change("y");
  FakeReceiver& other = new_viewer();
  watch(b(), other, "y");
  pass(100'000);
  EXPECT_EQ(other.infos.back().state, State::kLive) << "another sender of that broker";
  for (CountingViewer& one : crowd) b().hub->find("x")->unwatch(one);
}

TEST_F(BackboneTest, RowsOfOneStreamVisitNoOthersThatWait) {
  constexpr int kWaiting = 200, kRows = 1'000;
  EvilBroker evil(network, sha256(content(9, 9)));  // Its surface does not come.
  std::vector<CountingViewer> viewers(kWaiting);
  for (int i = 0; i < kWaiting; ++i) {
    const std::string name = "w" + std::to_string(i);
    evil.link.publish_row(name, text_from_entry(evil.entry), 1);
    watch(b(), viewers[static_cast<std::size_t>(i)], name);
  }
  evil.entry.announce.asset = b().put(content(3, 10)).hex();
  CountingViewer viewer;
  watch(b(), viewer, "x");
  pass(100'000);
  const std::uint64_t before = b().backbone->totals().names_compared;
  for (int i = 0; i < kRows; ++i) {
    ++evil.entry.epoch;
    evil.link.publish_row("x", text_from_entry(evil.entry), static_cast<std::uint64_t>(i) + 1);
    network.run();
  }
  EXPECT_LE(b().backbone->totals().names_compared - before, 5 * kRows);
  pass(25'000);
  EXPECT_EQ(b().hub->find("x")->epoch(), evil.entry.epoch);
  b().hub->find("x")->unwatch(viewer);
  for (int i = 0; i < kWaiting; ++i)
    b().hub->find("w" + std::to_string(i))->unwatch(viewers[static_cast<std::size_t>(i)]);
}

TEST_F(BackboneTest, SendersShareTheMemoryOfFollowedStreams) {
  EvilBroker owner(network, b().put(content(3, 10)));
  FakeReceiver viewers[24];
  const auto is_seen = [&](int i, const char* sender) {
    owner.entry.sender = sender;
    const std::string name = "s" + std::to_string(i);
    owner.link.publish_row(name, text_from_entry(owner.entry), 1);
    watch(b(), viewers[i], name);
    pass(100'000);
    return viewers[i].infos.back().state == State::kLive;
  };
  int seen = 0;
  while (seen < 20 && is_seen(seen, "greedy")) ++seen;
  EXPECT_GT(seen, 1);
  EXPECT_LT(seen, 20);
  EXPECT_TRUE(is_seen(21, "other")) << "of the same broker";
  EXPECT_FALSE(is_seen(22, "greedy"));
  for (int i = 0; i < 24; ++i) {
    if (Stream* stream = b().hub->find("s" + std::to_string(i))) stream->unwatch(viewers[i]);
  }
}

TEST_F(BackboneTest, TheRowOfAStreamNamesItsSenderByAHash) {
  const StreamHolder token{"token of camera"};
  const std::string sender = sender_of(token, "a's secret");
  EXPECT_EQ(sender.size(), 16U);
  EXPECT_EQ(sender, sender_of(StreamHolder{"token of camera", true, true}, "a's secret"));
  EXPECT_NE(sender, sender_of(StreamHolder{"address 10.0.0.1"}, "a's secret"));
  EXPECT_NE(sender, sender_of(token, "b's secret")) << "else a peer could try all addresses";
  DirectoryEntry entry{"a.1", 1, true, small_announce(), "proof", sender};
  EXPECT_EQ(entry_from_text(text_from_entry(entry)).value(), entry);
  EXPECT_EQ(payer_of(entry), "sender a " + sender) << "another broker that says the same is another's payer";
  entry.sender.clear();
  EXPECT_EQ(payer_of(entry), "broker a") << "whatever its run";
  entry.sender = std::string(200, 'x');
  EXPECT_FALSE(entry_from_text(text_from_entry(entry)));
}

TEST_F(BackboneTest, RowsOfABrokerBeyondItsBudgetAreLeftOut) {
  EvilBroker evil(network, sha256(content(1, 1)));
  std::string text = text_from_entry(evil.entry);
  text.pop_back();
  text += ",\"pad\":[";
  for (int i = 0; i < 2'400; ++i) text += "[],";
  text += "0]}";
  for (std::uint64_t i = 1; i <= 2'000; ++i) evil.link.publish_row("s" + std::to_string(i), text, i);
  network.run();
  const std::uint64_t known = b().backbone->totals().streams_known;
  EXPECT_GT(known, 500U);
  EXPECT_LT(known, 1'200U);
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
}

TEST(PeerWorkTest, EachNameOfABrokerHasABudgetForItsRows) {
  PeerWork work;
  for (int run = 0; run < 10; ++run) {
    EXPECT_EQ(work.take_row("evil." + std::to_string(run), 100'000, 0), run < 2) << "all runs together";
  }
  EXPECT_TRUE(work.take_row("good.1", 100'000, 0));
  EXPECT_TRUE(work.take_row("evil.1", 100'000, 1'000'000));
  for (std::size_t i = 0; i < 2 * PeerWork::kMaxNames; ++i) {
    EXPECT_EQ(work.take_row("b" + std::to_string(i) + ".1", 1, 1'000'000), i + 1 < PeerWork::kMaxNames);
  }
  EXPECT_TRUE(work.take_row("late.1", 1, 9'000'000)) << "idle ones are forgotten";
}

TEST(PeerWorkTest, SendersLeaveOthersOfTheirBrokerTheirShareOfItsFrames) {
  PeerWork work;
  const auto take_all = [&](const std::string& broker, const std::string& sender, TimeUs now_us) {
    std::int64_t taken_us = 0;
    for (int i = 0; i < 1'000; ++i) taken_us += work.take_frame(broker, sender, 99.5, now_us) ? 100 : 0;
    return taken_us;
  };
  EXPECT_GT(take_all("c.1", "0", 0), PeerWork::kFramesUs / 2 - 200) << "alone";
  for (int i = 0; i < 50; ++i) EXPECT_TRUE(work.take_frame("c.1", "small" + std::to_string(i), 99.5, 0));
  EXPECT_GE(take_all("c.1", "0", PeerWork::kPeriodUs), (PeerWork::kFramesUs - 50 * 100) / 2) << "beside small ones";
  for (TimeUs period = 1; period < 4; ++period) {
    std::int64_t all_us = 0;
    for (int i = 0; i < 8; ++i) {
      const std::int64_t own_us = take_all("a." + std::to_string(i), std::to_string(i), period * PeerWork::kPeriodUs);
      EXPECT_TRUE(period == 1 || own_us > PeerWork::kFramesUs / 9 - 200) << i << ": " << own_us;
      all_us += own_us;
    }
    EXPECT_LE(all_us, PeerWork::kFramesUs);
    EXPECT_GT(take_all("b.1", "0", period * PeerWork::kPeriodUs), PeerWork::kFramesUs / 2 - 200) << "another broker's";
  }
}

TEST(PeerWorkTest, ChangesBeyondTheLimitAreOwed) {
  PeerWork work;
  const auto first_us = [&](const std::string& broker, const std::string& sender) {
    TimeUs now_us = 0;
    while (!work.take_change(broker, sender, 10, now_us) && now_us < 10'000'000) now_us += 1'000;
    return now_us;
  };
  EXPECT_TRUE(work.take_change("a.1", "large", 8.0 * PeerWork::kChangesUs, 0)) << "even if it is more than all";
  EXPECT_EQ(first_us("b.1", "large"), 0);
  EXPECT_EQ(first_us("a.1", "small"), 8 * PeerWork::kChangesPeriodUs) << "its broker's is used up, too";
  const TimeUs again_us = first_us("a.1", "large");
  EXPECT_GE(again_us, 15 * PeerWork::kChangesPeriodUs) << "half of a broker's for a sender";
  EXPECT_LE(again_us, 20 * PeerWork::kChangesPeriodUs);
}

TEST_F(BackboneTest, AnOwnerThatIsSilentHoldsUpNoOther) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeLink evil(network);
  const auto silent = evil.serve("test.assets.evil", [](const Bytes&, const Link::Reply&) {});
  evil.publish("test.alive.evil", {'+'});
  DirectoryEntry entry{"evil", 1, true, small_announce(), {}};
  entry.announce.asset = asset.hex();
  evil.write_row("x", text_from_entry(entry), 0, [](const Result<std::uint64_t>& written) { EXPECT_TRUE(written); });
  network.run();
  watch(b(), new_viewer(), "x");
  pass(100'000);
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  send(sender);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
}

TEST_F(BackboneTest, AFloodOfJoinRequestsEncodesOneJoinAKey) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  const std::uint32_t epoch = sender.stream->epoch();
  FakeLink evil(network);
  int answers = 0;
  for (int i = 0; i < 1000; ++i) {
    Bytes request;
    ByteWriter out(request);
    out.u32(epoch);
    out.text("s");
    if (i == 500) send(sender);
    evil.ask("test.joins.a", request, 1'000'000,
             [&](const Result<Bytes>& answer) { answers += answer && !answer->empty(); });
    network.run();
  }
  EXPECT_EQ(answers, 1000);
  EXPECT_EQ(a().backbone->totals().joins_encoded, 2U);
}

TEST_F(BackboneTest, LostFramesCostOneJoin) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(100'000);
  for (int i = 0; i < 200; ++i) {
    network.drops = [&](const std::string& subject) { return i % 7 == 3 && subject == "test.frames.a.s"; };
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

TEST_F(BackboneTest, LocalStreamsWorkWithoutConnection) {
  SiteSender& sender = new_sender();
  SiteSender& another = new_sender();
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

TEST_F(BackboneTest, UnansweringTableIsBypassed) {
  network.table_answers = false;
  SiteSender& sender = new_sender();
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

TEST_F(BackboneTest, ABrokerThatStartsWithoutTheTableLearnsStreams) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  pass(1'000'000);
  network.table_answers = false;
  add_site("c");
  FakeReceiver& viewer = new_viewer();
  watch(*sites[2], viewer);
  pass(2'000'000);
  send(sender);
  ASSERT_FALSE(viewer.infos.empty());
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_FALSE(viewer.poses.empty());
}

TEST_F(BackboneTest, ABrokerThatReturnsWithoutTheTableLearnsOfNewSenders) {
  SiteSender& first = new_sender();
  SiteSender& second = new_sender();
  add_site("c");
  publish(first, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(1'000'000);
  ASSERT_EQ(viewer.infos.back().epoch, 1U);
  b().link.cut();
  pass(100'000);
  first.leave();
  pass(100'000);
  publish(second, *sites[2]);
  ASSERT_EQ(**second.granted, 2U);
  pass(1'000'000);
  network.table_answers = false;
  b().link.connect();
  pass(2'000'000);
  send(second);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.infos.back().epoch, 2U);
}

TEST_F(BackboneTest, LostTableIsRewritten) {
  publish(new_sender(), a(), "other");  // The revision of the entry of s is not that of the first of a new table.
  SiteSender& sender = new_sender();
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
  SiteSender& moved = new_sender();
  publish(moved, b());
  pass(100'000);
  send(moved);
  EXPECT_EQ(viewer.infos.back().epoch, moved.stream->epoch());
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(BackboneTest, OnlyBrokersWithStreamsSendEveryHeartbeat) {
  std::map<std::string, int> signs;
  const auto count = [&signs](const std::string& subject, const Bytes&) { ++signs[subject.substr(11)]; };
  FakeLink ear(network);
  const auto listening = ear.subscribe("test.alive.>", count);
  for (int i = 0; i < 1000; ++i) a().link.publish("test.alive.crowd-" + std::to_string(i), {'+'});
  pass(2'000'000);
  signs.clear();
  SiteSender& sender = new_sender();
  publish(sender, a());
  EXPECT_EQ(signs["a"], 1) << "before others hear of its stream";
  pass(20'000'000);
  EXPECT_GE(signs["a"], 20);
  EXPECT_LE(signs["b"], 2);
}

TEST_F(BackboneTest, EndedStreamsLeaveNothingInTheTable) {
  for (int i = 0; i < 20; ++i) {
    SiteSender& sender = new_sender();
    publish(sender, a(), "s" + std::to_string(i));
    sender.leave();
  }
  pass(1'000'000);
  EXPECT_EQ(network.table.size(), 20U) << "epochs go on from them for a while";
  for (int i = 0; i < 12; ++i) pass(60'000'000);
  EXPECT_TRUE(network.table.empty());
  SiteSender& again = new_sender();
  again.publish(b(), "s3", b().put(content(9, 10)));
  pass(1'000'000);
  ASSERT_TRUE(again.granted && *again.granted);
  EXPECT_EQ(network.table.size(), 1U);
  EXPECT_EQ(a().backbone->totals().streams_known, 1U);
}

TEST_F(BackboneTest, StreamsOfGoneBrokersEnd) {
  SiteSender& sender = new_sender();
  publish(sender, a());
  FakeReceiver& viewer = new_viewer();
  watch(b(), viewer);
  pass(6'000'000);
  ASSERT_EQ(viewer.infos.back().state, State::kLive);
  a().link.cut();
  pass(Directory::kHeartbeatTimeoutUs + 1'000'000);
  EXPECT_EQ(viewer.infos.back().state, State::kStalled);
  EXPECT_EQ(b().backbone->totals().streams_subscribed, 0U);
  EXPECT_EQ(b().backbone->totals().streams_known, 0U);
  a().link.connect();
  pass(2'000'000);
  send(sender);
  EXPECT_EQ(viewer.infos.back().state, State::kLive);
  EXPECT_EQ(viewer.undecodable, 0);
}

TEST_F(BackboneTest, MissingAssetIsRequestedAgain) {
  SiteSender& sender = new_sender();
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
  std::vector<SiteSender*> senders;
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
