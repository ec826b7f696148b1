// SPDX-License-Identifier: MIT
// A stream goes over to another asset of its surface, against a whole broker in this process.
#include <gtest/gtest.h>

#include <algorithm>

#include "common/reconstruction/reconstruct.h"
#include "common/wire/envelope.h"
#include "sdk/key_writer.h"
#include "sdk/surfaces.h"
#include "sdk/transfer.h"
#include "tests/unit/sdk/ball_stream.h"

namespace eigencast {
namespace {

std::vector<float> vertices_of(const Asset& asset, std::span<const double> C) {
  std::vector<float> X(std::size_t{3} * asset.vertex_count);
  positions_from_coefficients(asset, C, 3, asset.rank, asset.vertex_count, X);
  return X;
}

double farthest(const std::vector<float>& a, const std::vector<float>& b) {
  double most = 0;
  for (std::size_t i = 0; i < a.size(); i += 3)
    most = std::max(most, std::hypot(double{a[i]} - b[i], double{a[i + 1]} - b[i + 1], double{a[i + 2]} - b[i + 2]));
  return most;
}

TEST(Transfer, PosesOfFewerColumnsAreThoseOfMore) {
  const Asset &coarse = *model(40).asset, &fine = *model(90).asset;
  const auto up = Transfer::between(coarse, fine), down = Transfer::between(fine, coarse);
  ASSERT_TRUE(up && down);
  const auto C = pose(coarse, 3);
  const auto same = up->apply(C, 3);
  EXPECT_LT(farthest(vertices_of(coarse, C), vertices_of(fine, same)), 2e-3 * coarse.diagonal());
  const auto back = down->apply(same, 3);
  EXPECT_LT(farthest(vertices_of(coarse, C), vertices_of(coarse, back)), 2e-3 * coarse.diagonal());
  EXPECT_TRUE(up->apply(std::vector<double>(7), 3).empty());
}

TEST(Transfer, SurfacesOfOtherVerticesHaveNone) {
  auto other = bake(make_icosphere(2), {.basis = BasisKind::kAugmented, .rank = 40, .name = "ball"});
  ASSERT_TRUE(other);
  EXPECT_FALSE(Transfer::between(*model(40).asset, other->asset));
  Asset turned = *model(90).asset;
  std::swap(turned.source_vertex[0], turned.source_vertex[1]);
  EXPECT_FALSE(Transfer::between(*model(40).asset, turned));
}

TEST(ChangeOver, ItsFirstKeysAreAsCoarseAsOthersAndShort) {
  const Asset& asset = *model(90).asset;
  const CoefficientLayout layout{CodecKind::kQuantised, asset.rank, 3, asset.band_ends};
  const Quantiser quantiser = quantiser_for_error(1e-3 * asset.diagonal(), asset.area, asset.rank);
  const auto key = [&](int i) { return key_from_coefficients(layout, pose(asset, i), quantiser.step).value(); };
  KeyWriter writer(layout, quantiser.half_spacing, {});
  const ChainClock newest{7, 1'000'000, 33'333};
  writer.continue_as({}, newest, key(3));
  const auto coded = writer.code(key(4), 1'033'333);
  ASSERT_TRUE(coded) << coded.error().message;
  const auto frame = parse_frame(coded->message);
  ASSERT_TRUE(frame);
  const auto state = decode_join(layout, frame->envelope.bands, frame->payload);
  ASSERT_TRUE(state) << state.error().message;
  EXPECT_EQ(state->newer, coded->next.newer);
  const double spacing = 2 * quantiser.half_spacing * step_size(quantiser.step);
  const auto compare = [&](const Key& got, int i) {
    const auto C = coefficients_from_key(layout, got), wanted = pose(asset, i);
    for (std::size_t k = 0; k < C.size(); ++k) ASSERT_NEAR(C[k], wanted[k], 0.55 * spacing) << k;
  };
  compare(state->older, 3);
  compare(state->newer, 4);
  const Bytes exact = encode_join(layout, {key(3), key(4), 33'333}).value();
  EXPECT_LT(3 * frame->payload.size(), 2 * exact.size());
}

TEST(ChangeOver, AnotherSurfaceIsRefused) {
  LoopbackBroker broker;
  Sender sender(broker, 40);
  auto other = bake(make_icosphere(2), {.basis = BasisKind::kAugmented, .rank = 40, .name = "ball"});
  const auto refused = sender.publisher->change_to(std::make_shared<const Asset>(std::move(other->asset)),
                                                   std::make_shared<const EncodedAsset>(std::move(other->encoded)));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
}

/// Poses of the surface whatever asset is sent with.
class Changing {
 public:
  Changing(const LoopbackBroker& broker, CodecKind codec) : sender_(broker, 40, codec) {}
  Publisher& publisher() { return *sender_.publisher; }
  SendStatus send() {
    const auto X = vertices_of(*model(90).asset, pose(*model(90).asset, count_));
    std::vector<float> source(X.size());
    for (std::size_t row = 0; row < model(90).asset->vertex_count; ++row) {
      for (std::size_t d = 0; d < 3; ++d)
        source[3 * model(90).asset->source_vertex[row] + d] =
            static_cast<float>(double{X[3 * row + d]} + model(90).asset->origin[d]);
    }
    const auto sent = publisher().send_positions(source, steady_now_us());
    if (sent && *sent == SendStatus::kSent) ++count_;
    return sent ? *sent : SendStatus::kDropped;
  }
  int sent() const { return count_; }

 private:
  Sender sender_;
  int count_ = 0;
};

TEST(ChangeOver, ViewersSeeOneContinuousStream) {
  LoopbackBroker broker;
  Changing sender(broker, CodecKind::kQuantised);
  const auto viewer = eigencast::subscribe(broker);
  struct Seen {
    std::uint32_t epoch;
    std::uint64_t sequence;
    std::vector<float> positions;
  };
  std::vector<Seen> seen;
  const auto watch = [&] {
    for (const ReceivedPose& p : viewer->poll(milliseconds(4))) {
      ASSERT_EQ(p.coefficients.size(), std::size_t{3} * viewer->asset()->rank);
      seen.push_back(
          {p.envelope.epoch, p.envelope.sequence,
           vertices_of(*viewer->asset(), std::span<const double>(p.coefficients.begin(), p.coefficients.size()))});
    }
  };
  ASSERT_TRUE(eventually([&] {
    (void)sender.send();
    watch();
    return seen.size() >= 10;
  }));
  ASSERT_TRUE(sender.publisher().change_to(model(90).asset, model(90).encoded));
  std::optional<std::size_t> changed;
  ASSERT_TRUE(eventually([&] {
    (void)sender.send();
    watch();
    if (viewer->asset() != nullptr && viewer->asset()->rank == 90 && !changed) {
      changed = seen.size();
      EXPECT_NE(viewer->change(), nullptr);
    }
    return changed && seen.size() >= *changed + 20;
  }));
  EXPECT_EQ(sender.publisher().stats().changes, 1u);
  const Publisher::Stats stats = sender.publisher().stats();
  EXPECT_EQ(stats.reconnects, 0u);
  EXPECT_EQ(viewer->stats().rejected, 0u);
  double usual = 0, around = 0;
  for (std::size_t i = 1; i < seen.size(); ++i) {
    EXPECT_GT(seen[i].sequence, seen[i - 1].sequence) << "numbers go on";
    // Frames that newer ones overtook do not come: the motion of those between counts, too.
    const double step = farthest(seen[i].positions, seen[i - 1].positions) /
                        static_cast<double>(seen[i].sequence - seen[i - 1].sequence);
    const bool is_around = i >= *changed && i < *changed + 9;
    (is_around ? around : usual) = std::max(is_around ? around : usual, step);
  }
  EXPECT_LE(around, 1.5 * usual) << "no vertex jumps more than it usually moves";
}

TEST(ChangeOver, LostConnectionsAreMadeUpFor) {
  LoopbackBroker broker;
  Changing sender(broker, CodecKind::kQuantised);
  ASSERT_TRUE(eventually([&] { return sender.send() == SendStatus::kSent; }));
  broker.stop();
  ASSERT_TRUE(sender.publisher().change_to(model(90).asset, model(90).encoded));
  ASSERT_TRUE(eventually([&] { return sender.publisher().stats().state != Publisher::State::kLive; }));
  (void)sender.send();
  EXPECT_EQ(sender.publisher().asset()->rank, 90u) << "nobody is there to prepare";
  broker.start();
  ASSERT_TRUE(eventually([&] { return sender.send() == SendStatus::kSent; }));
  const auto viewer = eigencast::subscribe(broker);
  ASSERT_TRUE(eventually([&] {
    (void)sender.send();
    return !viewer->poll(milliseconds(4)).empty();
  }));
  EXPECT_EQ(viewer->asset()->rank, 90u);
}

TEST(ChangeOver, ViewersWithoutMemoryForItChangeWithoutCarryingPosesOver) {
  LoopbackBroker broker;
  Changing sender(broker, CodecKind::kQuantised);
  constexpr std::uint64_t kEnough = std::uint64_t{1} << 30;
  MemoryBudget budget(kEnough);
  SubscriberOptions options{broker.url("live/ball"), Profile{.rate = Profile::Rate::kRaw}, {}};
  options.memory = &budget;
  const auto viewer = Subscriber::create(options);
  ASSERT_TRUE(viewer);
  std::size_t poses = 0;
  const auto watch = [&] {
    (void)sender.send();
    poses += (*viewer)->poll(milliseconds(4)).size();
    return poses;
  };
  ASSERT_TRUE(eventually([&] { return watch() >= 5 && (*viewer)->asset()->complete(); }));
  const EncodedAsset& next = *model(90).encoded;
  const auto reader = AssetReader::from_manifest(next.manifest.id, next.manifest.bytes);
  budget.set_limit(kEnough - budget.remaining() + reader->memory_bytes() + 1'000);
  ASSERT_LT(1'000U, Transfer::cost(*model(40).asset, *model(90).asset).bytes);
  ASSERT_TRUE(sender.publisher().change_to(model(90).asset, model(90).encoded));
  ASSERT_TRUE(eventually([&] { return watch() > 0 && (*viewer)->asset()->rank == 90; }));
  EXPECT_EQ((*viewer)->change(), nullptr);
  poses = 0;
  ASSERT_TRUE(eventually([&] { return watch() >= 5; })) << "the stream goes on";
}

TEST(ChangeOver, ViewersThatComeInBetweenSeeWhatIsSent) {
  LoopbackBroker broker;
  Changing sender(broker, CodecKind::kFloat64);
  ASSERT_TRUE(eventually([&] { return sender.send() == SendStatus::kSent; }));
  ASSERT_TRUE(sender.publisher().change_to(model(90).asset, model(90).encoded));
  const auto viewer = eigencast::subscribe(broker);
  std::size_t poses = 0;
  ASSERT_TRUE(eventually([&] {
    (void)sender.send();
    poses += viewer->poll(milliseconds(4)).size();
    return viewer->asset() != nullptr && viewer->asset()->rank == 90 && poses >= 5;
  }));
  EXPECT_EQ(viewer->stats().rejected, 0u);
}

}  // namespace
}  // namespace eigencast
