// SPDX-License-Identifier: MIT
#include "sdk/stream_learner.h"

#include <gtest/gtest.h>

#include <map>
#include <mutex>
#include <optional>

#include "common/asset/format/reader.h"
#include "common/reconstruction/reconstruct.h"
#include "sdk/subscriber.h"
#include "tests/support/loopback_broker.h"
#include "tests/unit/sdk/folded_torus.h"

namespace eigencast {
namespace {

using testing::eventually;
using testing::LoopbackBroker;
using testing::milliseconds;

constexpr TimeUs kInterval = 33'333;

double eps() {
  return 1e-3 * folded_torus().asset->diagonal();
}

/// A learner of the torus, and what came of it.
class Lesson {
 public:
  explicit Lesson(LearnUse use)
      : learner_(use,
                 [this](const std::shared_ptr<const Asset>& from, const LearntAsset& learnt) {
                   EXPECT_EQ(from, folded_torus().asset);
                   const std::lock_guard lock(mutex_);
                   EXPECT_FALSE(learnt_) << "once";
                   learnt_ = learnt;
                 },
                 {}) {
    learner_.begin(folded_torus().asset, folded_torus().encoded, eps());
  }
  /// Poses one after the other, all of which it takes; false: it wants no more.
  bool show(std::size_t poses, double bumps, double waves = 1) {
    const auto projector = Projector::create(*folded_torus().asset);
    for (std::size_t i = 0; i < poses; ++i, ++shown_) {
      const std::vector<float> pose = torus_pose(shown_, bumps, waves);
      const auto due_us = static_cast<TimeUs>(shown_ + 1) * kInterval;
      if (!eventually([&] { return learner_.wants(due_us) || learnt(); }) || learnt()) return false;
      learner_.add(pose, *projector->coefficients_from_positions(pose), due_us);
    }
    return true;
  }
  std::optional<LearntAsset> learnt() {
    const std::lock_guard lock(mutex_);
    return learnt_;
  }
  std::size_t shown() const { return shown_; }
  StreamLearner& learner() { return learner_; }

 private:
  std::mutex mutex_;
  std::optional<LearntAsset> learnt_;
  std::size_t shown_ = 0;
  StreamLearner learner_;  ///< Last: its thread uses all above.
};

TEST(StreamLearner, LearnsWhatTheBasisMissesAfterThreeSeconds) {
  Lesson lesson(LearnUse::kAuto);
  ASSERT_TRUE(lesson.show(90, 1)) << "not before";
  EXPECT_FALSE(lesson.learnt());
  EXPECT_FALSE(lesson.show(10, 1));
  const auto learnt = lesson.learnt();
  ASSERT_TRUE(learnt);
  EXPECT_GT(learnt->asset->rank, folded_torus().asset->rank);
  EXPECT_GE(learnt->coarser, 1);
  EXPECT_EQ(learnt->encoded->chunks.size(), folded_torus().encoded->chunks.size());
  ASSERT_EQ(learnt->encoded->sections.size(), 1u);
  const auto decoded = decode_asset(*learnt->encoded);
  ASSERT_TRUE(decoded) << decoded.error().message;
  EXPECT_EQ(decoded->integers, learnt->asset->integers) << "what receivers read";
  const std::vector<float> unseen = torus_pose(200, 1);
  const auto before = Projector::create(*folded_torus().asset), after = Projector::create(*learnt->asset);
  ASSERT_TRUE(before && after);
  EXPECT_LT(3 * rms_error(*learnt->asset, unseen, *after->coefficients_from_positions(unseen)),
            rms_error(*folded_torus().asset, unseen, *before->coefficients_from_positions(unseen)));
}

TEST(StreamLearner, DecidesAgainAsMoreComes) {
  Lesson lesson(LearnUse::kAuto);
  ASSERT_TRUE(lesson.show(100, 0, 0.02)) << "nothing is missed yet";
  EXPECT_FALSE(lesson.learnt());
  EXPECT_FALSE(lesson.show(1000, 1));
  EXPECT_TRUE(lesson.learnt());
}

TEST(StreamLearner, EndsAndBeginsAtAnyTime) {
  Lesson lesson(LearnUse::kOn);
  ASSERT_TRUE(lesson.show(50, 1));
  lesson.learner().end();
  EXPECT_FALSE(lesson.learner().wants(1'000'000'000));
  lesson.learner().begin(folded_torus().asset, folded_torus().encoded, eps());
  ASSERT_TRUE(lesson.show(80, 1)) << "what came before is forgotten";
  EXPECT_FALSE(lesson.show(100, 1));
  EXPECT_TRUE(lesson.learnt());
}

/// The torus on its way to viewers.
class Show {
 public:
  explicit Show(const LoopbackBroker& broker, MemoryUse memory = MemoryUse::kOff) {
    PublisherOptions options;
    options.url = broker.url("live/torus");
    options.learn = LearnUse::kOn;
    options.memory = memory;
    publisher = std::move(*Publisher::create(options, folded_torus().asset, folded_torus().encoded));
  }
  /// The next pose, if it is time.
  void send() {
    const TimeUs now = steady_now_us();
    if (now < next_us_) return;
    next_us_ = now + 20'000;
    const std::vector<float> pose = torus_pose(count_++, 1, 0.3);
    const auto sent = publisher->send_positions(pose, now);
    ASSERT_TRUE(sent) << sent.error().message;
    if (*sent != SendStatus::kSent) return;
    truth[now] = pose;
    received[now] = publisher->as_received();
  }
  std::unique_ptr<Publisher> publisher;
  std::map<TimeUs, std::vector<float>> truth;
  std::map<TimeUs, std::vector<double>> received;

 private:
  std::size_t count_ = 0;
  TimeUs next_us_ = 0;
};

std::unique_ptr<Subscriber> viewer_of(const LoopbackBroker& broker) {
  return std::move(*Subscriber::create({broker.url("live/torus"), Profile{.rate = Profile::Rate::kRaw}, {}}));
}

TEST(StreamLearner, ViewersFetchNothingButColumnsAndSeeOneStream) {
  LoopbackBroker broker;
  Show show(broker);
  const auto viewer = viewer_of(broker);
  struct Seen {
    std::uint64_t sequence;
    double error;
    std::vector<float> positions;
  };
  std::vector<Seen> seen;
  std::optional<std::size_t> changed;
  const auto watch = [&] {
    for (const ReceivedPose& p : viewer->poll(milliseconds(2))) {
      const Asset& asset = *viewer->asset();
      ASSERT_EQ(p.coefficients.size(), std::size_t{3} * asset.rank);
      if (!asset.complete()) continue;
      const std::span<const double> C(p.coefficients.begin(), p.coefficients.size());
      std::vector<float> positions(std::size_t{3} * asset.vertex_count);
      positions_from_coefficients(asset, C, 3, asset.rank, asset.vertex_count, positions);
      if (!changed && asset.rank > folded_torus().asset->rank) {
        changed = seen.size();
        EXPECT_NE(viewer->change(), nullptr);
      }
      const auto sent = show.received.find(p.envelope.capture_us);
      ASSERT_NE(sent, show.received.end());
      EXPECT_TRUE(sent->second.size() != C.size() || std::equal(C.begin(), C.end(), sent->second.begin()))
          << "as the sender's decoder has it";
      seen.push_back({p.envelope.sequence, rms_error(asset, show.truth[p.envelope.capture_us], C), positions});
    }
  };
  ASSERT_TRUE(eventually([&] {
    show.send();
    watch();
    return changed && seen.size() >= *changed + 40;
  }));
  const Publisher::Stats stats = show.publisher->stats();
  EXPECT_EQ(stats.changes, 1u);
  EXPECT_EQ(stats.reconnects, 0u);
  EXPECT_EQ(stats.learnt_columns, viewer->asset()->rank - folded_torus().asset->rank);
  EXPECT_EQ(viewer->stats().rejected, 0u);
  EXPECT_EQ(viewer->stats().asset_bytes_downloaded, folded_torus().encoded->total_bytes() + stats.learnt_bytes)
      << "no chunk twice, though there is no cache";
  double usual = 0, around = 0, before = 0, after = 0;
  for (std::size_t i = 1; i < seen.size(); ++i) {
    EXPECT_GT(seen[i].sequence, seen[i - 1].sequence);
    double step = 0;
    for (std::size_t v = 0; v < seen[i].positions.size(); ++v)
      step = std::max(step, std::abs(double{seen[i].positions[v]} - seen[i - 1].positions[v]));
    step /= static_cast<double>(seen[i].sequence - seen[i - 1].sequence);
    const bool is_around = i >= *changed && i < *changed + 9;
    (is_around ? around : usual) = std::max(is_around ? around : usual, step);
    if (i < *changed) before = std::max(before, seen[i].error);
    if (i >= *changed + 9) after = std::max(after, seen[i].error);
  }
  EXPECT_LE(around, 1.5 * usual) << "no vertex jumps more than it usually moves";
  EXPECT_LT(3 * after, before);
}

TEST(StreamLearner, ViewersThatComeLaterFetchAllAtOnce) {
  LoopbackBroker broker;
  Show show(broker);
  ASSERT_TRUE(eventually([&] {
    show.send();
    return show.publisher->stats().changes == 1;
  }));
  const auto viewer = viewer_of(broker);
  ASSERT_TRUE(eventually([&] {
    show.send();
    return !viewer->poll(milliseconds(2)).empty();
  }));
  EXPECT_EQ(viewer->asset()->rank, show.publisher->asset()->rank);
  EXPECT_EQ(viewer->change(), nullptr);
}

TEST(StreamLearner, LostConnectionsAreMadeUpFor) {
  LoopbackBroker broker;
  Show show(broker);
  const auto viewer = viewer_of(broker);
  ASSERT_TRUE(eventually([&] {
    show.send();
    return !viewer->poll(milliseconds(2)).empty();
  }));
  broker.stop();
  ASSERT_TRUE(eventually([&] {
    show.send();
    return show.publisher->stats().changes == 1;
  })) << "nobody is there to prepare, but poses come all the same";
  broker.start();
  ASSERT_TRUE(eventually([&] {
    show.send();
    const auto poses = viewer->poll(milliseconds(2));
    return !poses.empty() && poses.back().coefficients.size() == std::size_t{3} * show.publisher->asset()->rank;
  }));
  EXPECT_EQ(viewer->stats().rejected, 0u);
}

}  // namespace
}  // namespace eigencast
