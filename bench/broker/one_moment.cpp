// SPDX-License-Identifier: MIT
//
// Whether viewers show the same moment: one_moment URL [VIEWERS [SECONDS [GROUP [LOSS [PLAYOUT]]]]]
//
// Watches a stream of a broker on this machine as so many viewers (100), each behind an impaired link of its own: 5 to
// 85 ms each way, jitter of up to a quarter of that, LOSS (0) of segments. Each plays out by its own Playout and its
// own estimate of the broker's clock, 60 times a second. Ten seconds after all have the surface it notes for SECONDS
// (20) how far the moment that each shows is from the median's, by this machine's clock, which links do not touch, and
// how far its pose is from the sender's of that median, in milliseconds of mean motion. GROUP (one): that of `sync`;
// "-": none, for comparison. PLAYOUT: `estimate` (default, as of --sync) or `interpolate`. Prints a line of JSON.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "common/core/clock.h"
#include "common/motion/curve.h"
#include "common/motion/playout.h"
#include "common/net/url.h"
#include "sdk/subscriber.h"
#include "tests/support/impaired_relay.h"

namespace {

using namespace eigencast;
using testing::ImpairedRelay;

constexpr TimeUs kSettleUs = 10'000'000, kPictureUs = 16'667, kPatienceUs = 120'000'000;

struct Viewer {
  std::unique_ptr<ImpairedRelay> link;
  std::unique_ptr<Subscriber> subscriber;
  Playout playout;
  std::uint32_t epoch = 0;
  std::uint64_t pictures = 0, held = 0, estimated = 0;

  /// What is shown; nothing: no pose yet.
  std::optional<PlayoutPose> show(TimeUs now) {
    const auto poses = subscriber->poll(std::chrono::milliseconds(0));
    if (epoch != subscriber->epoch()) playout.reset();
    epoch = subscriber->epoch();
    for (const ReceivedPose& pose : poses) {
      const Shown shown = pose.envelope.kind == FrameKind::kStep ? Shown::kInterpolated : Shown::kLive;
      playout.add({pose.envelope.capture_us, pose.coefficients, 0xff, shown}, pose.arrival_us);
      if (pose.next) playout.add_next({pose.next->capture_us, pose.next->coefficients, 0xff});
    }
    const auto moment = subscriber->moment();
    playout.set_lag(moment ? std::optional(moment->lag_us) : std::nullopt);
    if (const auto needed = playout.needed_lag_us()) subscriber->report_late(*needed);
    auto pose = playout.at(now);
    if (!pose) return std::nullopt;
    ++pictures;
    held += pose->shown == Shown::kHeld ? 1 : 0;
    estimated += pose->shown == Shown::kEstimated ? 1 : 0;
    return pose;
  }
};

bool has_whole_surface(const Viewer& viewer) {
  const Asset* asset = viewer.subscriber->asset();
  return asset != nullptr && asset->rows_ready == asset->vertex_count;
}

double distance(const Coefficients& a, const Coefficients& b) {
  double sum = 0;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
  return std::sqrt(sum);
}

/// The stream without a link.
class Truth {
 public:
  explicit Truth(std::unique_ptr<Subscriber> subscriber) : subscriber_(std::move(subscriber)) {}

  void poll() {
    for (ReceivedPose& pose : subscriber_->poll(std::chrono::milliseconds(0))) {
      const TimeUs at_us = pose.envelope.capture_us;
      if (!keys_.empty() && at_us <= keys_.back().time_us) continue;
      if (!keys_.empty()) {
        way_ += distance(pose.coefficients, keys_.back().coefficients);
        time_us_ += at_us - keys_.back().time_us;
      }
      keys_.push_back({at_us, std::move(pose.coefficients)});
      if (keys_.size() > 128) keys_.pop_front();
    }
  }
  /// Nothing: too old, or the key after it has not come.
  std::optional<Coefficients> at(TimeUs t_us) const {
    const auto to = std::upper_bound(keys_.begin(), keys_.end(), t_us,
                                     [](TimeUs t, const PlayoutPose& key) { return t < key.time_us; });
    if (to - keys_.begin() < 2 || keys_.end() - to < 2) return std::nullopt;
    const auto from = to - 1, before = from - 1, after = to + 1;
    const CurveWeights w =
        catmull_rom_weights(before->time_us, from->time_us, to->time_us, after->time_us, t_us);
    std::vector<double> pose(to->coefficients.size());
    for (std::size_t i = 0; i < pose.size(); ++i)
      pose[i] = w.before * before->coefficients[i] + w.from * from->coefficients[i] + w.to * to->coefficients[i] +
                w.after * after->coefficients[i];
    return Coefficients(std::move(pose));
  }
  double mean_speed() const { return way_ / static_cast<double>(std::max<TimeUs>(time_us_, 1)); }

 private:
  std::unique_ptr<Subscriber> subscriber_;
  std::deque<PlayoutPose> keys_;
  double way_ = 0;
  TimeUs time_us_ = 0;
};

double at(const std::vector<TimeUs>& sorted, double part) {
  return sorted.empty()
             ? -1
             : static_cast<double>(sorted[static_cast<std::size_t>(part * static_cast<double>(sorted.size() - 1))]) /
                   1000;
}

}  // namespace

int main(int argc, char** argv) {
  const auto url = argc > 1 ? parse_broker_url(argv[1]) : Result<BrokerUrl>(fail(ErrorCode::kInvalidArgument, "URL?"));
  if (!url)
    return std::fprintf(stderr, "one_moment URL [VIEWERS [SECONDS [GROUP [LOSS [PLAYOUT]]]]]: %s\n",
                        url.error().message.c_str()),
           2;
  const int count = argc > 2 ? std::atoi(argv[2]) : 100;
  const double seconds = argc > 3 ? std::atof(argv[3]) : 20;
  const std::string group = argc > 4 ? argv[4] : "one";
  PlayoutSettings playout{PlayoutMode::kEstimate, 1, 0, 200'000};
  if (argc > 6 && argv[6] == std::string("interpolate")) playout.mode = PlayoutMode::kInterpolate;
  std::mt19937_64 random(7);
  const auto uniform = [&](double low, double high) { return std::uniform_real_distribution(low, high)(random); };
  std::vector<Viewer> viewers(static_cast<std::size_t>(count));
  for (Viewer& viewer : viewers) {
    ImpairedRelay::Options link;
    link.target_port = url->port;
    link.to_target.delay_us = link.from_target.delay_us = static_cast<TimeUs>(uniform(5'000, 85'000));
    link.to_target.jitter_us = link.from_target.jitter_us =
        static_cast<TimeUs>(uniform(0, 0.25) * static_cast<double>(link.to_target.delay_us));
    link.from_target.loss = argc > 5 ? std::atof(argv[5]) : 0;
    link.to_target.seed = random();
    link.from_target.seed = random();
    auto relay = ImpairedRelay::start(link);
    if (!relay) return std::fprintf(stderr, "%s\n", relay.error().message.c_str()), 1;
    viewer.link = std::move(*relay);
    SubscriberOptions options;
    options.url = viewer.link->url(url->stream);
    options.profile = Profile{Profile::Rate::kRaw, 3, 8, Profile::Scheme::kLinear};
    if (group != "-") options.sync = group;
    auto subscriber = Subscriber::create(std::move(options));
    if (!subscriber) return std::fprintf(stderr, "%s\n", subscriber.error().message.c_str()), 1;
    viewer.subscriber = std::move(*subscriber);
    viewer.playout.set(playout);
  }
  SubscriberOptions direct;
  direct.url = argv[1];
  direct.profile = Profile{Profile::Rate::kRaw, 3, 8, Profile::Scheme::kLinear};
  auto direct_subscriber = Subscriber::create(std::move(direct));
  if (!direct_subscriber) return std::fprintf(stderr, "%s\n", direct_subscriber.error().message.c_str()), 1;
  Truth truth(std::move(*direct_subscriber));
  const TimeUs start = steady_now_us();
  TimeUs settled_us = start + kSettleUs, end = settled_us + static_cast<TimeUs>(seconds * 1e6);
  std::vector<TimeUs> off, pose_off;
  TimeUs longest_us = 0;
  std::vector<std::vector<TimeUs>> of_viewer(viewers.size());
  for (TimeUs next = start; steady_now_us() < end; next += kPictureUs) {
    std::this_thread::sleep_for(std::chrono::microseconds(std::max<TimeUs>(0, next - steady_now_us())));
    truth.poll();
    const TimeUs begun = steady_now_us();
    std::vector<std::optional<PlayoutPose>> shown;
    std::vector<TimeUs> shown_at, moments;
    for (Viewer& viewer : viewers) {
      shown_at.push_back(steady_now_us());
      shown.push_back(viewer.show(shown_at.back()));
      if (shown.back()) moments.push_back(shown.back()->time_us - shown_at.back());
    }
    next = std::max(next, begun - kPictureUs);  // Pictures that a busy machine misses are not made up for.
    // Reading a hundred surfaces in one thread is nothing that a viewer does.
    if (!std::all_of(viewers.begin(), viewers.end(), has_whole_surface) && begun - start < kPatienceUs) {
      settled_us = begun + kSettleUs;
      end = settled_us + static_cast<TimeUs>(seconds * 1e6);
    }
    if (begun < settled_us || moments.empty()) continue;
    std::nth_element(moments.begin(), moments.begin() + static_cast<std::ptrdiff_t>(moments.size() / 2), moments.end());
    const TimeUs median = moments[moments.size() / 2];
    for (std::size_t i = 0; i < shown.size(); ++i) {
      if (!shown[i]) continue;
      off.push_back(std::abs(shown[i]->time_us - shown_at[i] - median));
      of_viewer[i].push_back(off.back());
      const auto right = truth.at(shown_at[i] + median);
      if (right) pose_off.push_back(std::llround(distance(shown[i]->coefficients, *right) / truth.mean_speed()));
    }
    longest_us = std::max(longest_us, steady_now_us() - begun);
  }
  std::sort(pose_off.begin(), pose_off.end());
  std::sort(off.begin(), off.end());
  int within8 = 0, within16 = 0, watching = 0;
  std::uint64_t pictures = 0, held = 0, estimated = 0;
  for (std::size_t i = 0; i < viewers.size(); ++i) {
    auto& mine = of_viewer[i];
    std::sort(mine.begin(), mine.end());
    watching += mine.empty() ? 0 : 1;
    within8 += at(mine, 0.99) >= 0 && at(mine, 0.99) <= 8 ? 1 : 0;
    within16 += at(mine, 0.99) >= 0 && at(mine, 0.99) <= 16 ? 1 : 0;
    pictures += viewers[i].pictures;
    held += viewers[i].held;
    estimated += viewers[i].estimated;
  }
  const auto part = [&](std::uint64_t count_of) {
    return static_cast<double>(count_of) / static_cast<double>(std::max<std::uint64_t>(pictures, 1));
  };
  std::printf(
      "{\"viewers\":%d,\"watching\":%d,\"off_ms\":{\"p50\":%.2f,\"p95\":%.2f,\"p99\":%.2f,\"max\":%.2f},"
      "\"pose_off_ms\":{\"p50\":%.2f,\"p95\":%.2f,\"p99\":%.2f,\"max\":%.2f},"
      "\"viewers_p99_within_8_ms\":%d,\"within_16_ms\":%d,\"held\":%.5f,\"estimated\":%.5f,\"delay_ms\":%.1f,"
      "\"longest_turn_ms\":%.1f}\n",
      count, watching, at(off, 0.5), at(off, 0.95), at(off, 0.99), at(off, 1), at(pose_off, 0.5), at(pose_off, 0.95),
      at(pose_off, 0.99), at(pose_off, 1), within8, within16, part(held), part(estimated),
      static_cast<double>(viewers.front().playout.delay_us()) / 1000, static_cast<double>(longest_us) / 1000);
  return 0;
}
