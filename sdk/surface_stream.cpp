// SPDX-License-Identifier: MIT
#include "sdk/surface_stream.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "common/core/text.h"
#include "common/surface/cells.h"
#include "sdk/broker.h"
#include "sdk/stream_pace.h"

namespace eigencast {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kLivePoll{5};
/// Brokers take no higher one; such a limit says nothing of the program's rate.
constexpr double kMostAnnouncedHz = 1000;
constexpr TimeUs kFarewellUs = 1'000'000;
/// Of a learnt range that is narrow for its values: what they are told apart by, over the largest.
constexpr double kLeastErrorOverValue = 1e-6;
/// What is smaller is noise, and what is larger a solver that blew up: streams can state neither for any surface.
constexpr float kLeastLearnt = 1e-12F, kMostLearnt = 1e15F;

/// A pose in the stream's own axes and units.
struct StreamPose {
  std::vector<float> points, velocities, scalars;
  TimeUs capture_us = 0;
  bool held = false;  ///< It came before it could go out: it holds now.
};

/// What a surface is made of, as the program gave it.
struct Topology {
  std::vector<std::uint32_t> corners;
  std::vector<std::uint64_t> offsets;
  std::size_t points = 0;
  bool velocities = false;
};

template <typename T>
bool equal(std::span<const T> a, const std::vector<T>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end());
}

class ThreadedStream final : public SurfaceStream {
 public:
  ThreadedStream(SurfaceStreamOptions options, LogSink log)
      : options_(std::move(options)),
        log_(std::move(log)),
        scalars_(options_.publisher.scalars),
        queue_(options_.max_rate_hz) {
    worker_ = std::thread([this] { run(); });
  }

  ~ThreadedStream() override {
    {
      const std::lock_guard lock(mutex_);
      stopped_ = true;
      end_us_ = steady_now_us() + kFarewellUs;
    }
    wake_.notify_all();
    worker_.join();
  }

  Result<Sent> send(const Frame& frame) override {
    const TimeUs now = steady_now_us();
    if (const auto usable = check(frame); !usable) return usable.error();
    std::unique_lock lock(mutex_);
    if (const auto known = recognise(frame); !known) return known.error();
    if (failure_) return *failure_;
    StreamPose pose = std::move(spare_);
    spare_ = {};
    lock.unlock();  // Copies of a large surface take as long as the thread takes to look for work.
    if (const auto copied = copy(frame, pose); !copied) return copied.error();
    lock.lock();
    if (failure_) return *failure_;  // its bake failed meanwhile
    pose.capture_us = time_.capture_us(now, frame.time_s);
    ++stats_.taken;
    if (wanted_ || !ready_) {
      begin_with(std::move(pose));
      return Sent::kBaking;
    }
    const bool live = publisher_->state() == Publisher::State::kLive;
    if (!live)
      begin_with(std::move(pose));
    else
      add(std::move(pose), now);
    lock.unlock();
    wake_.notify_all();
    return live ? Sent::kTaken : Sent::kDisconnected;
  }

  Result<bool> wait_live(milliseconds timeout) override {
    const auto end = std::chrono::steady_clock::now() + timeout;
    std::unique_lock lock(mutex_);
    if (stats_.topologies == 0)
      return fail(ErrorCode::kInvalidArgument, "nothing was sent yet: the first pose says what surface it is");
    while (true) {
      if (failure_) return *failure_;
      if (ready_ && !wanted_) {
        const Publisher::Stats now = publisher_->stats();
        if (now.state == Publisher::State::kLive) return true;
        if (now.gave_up) return fail(ErrorCode::kRefused, now.detail);
      }
      if (std::chrono::steady_clock::now() >= end) return false;
      wake_.wait_for(lock, kLivePoll);
    }
  }

  Stats stats() const override {
    const std::lock_guard lock(mutex_);
    Stats now = stats_;
    now.baking = wanted_.has_value() || baking_;
    if (publisher_) {
      now.publisher = publisher_->stats();
      count(now, now.publisher);
    }
    if (failure_) {
      now.detail = failure_->message;
    } else if (wanted_ || (baking_ && !ready_)) {
      now.detail = "baking: " + (stage_.empty() ? "begins" : stage_);
      if (stats_.topologies > stats_.bakes + 1)
        now.detail += formatted("; %.0f topologies were gone before they were baked",
                                static_cast<double>(stats_.topologies - stats_.bakes - 1));
    } else {
      now.detail = publisher_               ? now.publisher.detail
                   : stats_.topologies == 0 ? "waits for the first pose"
                                            : "begins anew: scalars have another range";
      if (baking_) now.detail += ", coarse: all of the basis is being made, " + stage_;
    }
    if (now.loose_faces) now.detail += "; the faces share no vertices: weld them";
    return now;
  }

 private:
  struct Job {
    Surface surface;
    bool loose = false;  ///< See is_triangle_soup().
  };

  /// Ranges of `scalars` for which the program gave none, from a pose that lies further out of them than they are wide;
  /// false: there is nothing to learn.
  bool learn(std::vector<Scalar>& scalars, std::span<const float> values) const {
    bool learnt = false;
    for (std::size_t k = 0; k < scalars.size(); ++k) {
      const Scalar& given = options_.publisher.scalars[k];
      if (given.low != given.high || given.error != 0) continue;
      float low = values[k], high = values[k];
      for (std::size_t i = k; i < values.size(); i += scalars.size()) {
        low = std::min(low, values[i]);
        high = std::max(high, values[i]);
      }
      if (low == high) {  // of a constant the range from 0
        low = std::min(low, 0.0F);
        high = std::max(high, 0.0F);
      }
      if (const float most = std::max(-low, high); low == high || most < kLeastLearnt || most > kMostLearnt) continue;
      Scalar& known = scalars[k];
      const double width = known.high - known.low;
      if (width > 0 && low >= known.low - width && high <= known.high + width) continue;
      known.low = width > 0 ? std::min<double>(known.low, low) : low;
      known.high = width > 0 ? std::max<double>(known.high, high) : high;
      known.error = std::max(kDefaultErrorOverDiagonal * (known.high - known.low),
                             kLeastErrorOverValue * std::max(std::abs(known.low), std::abs(known.high)));
      learnt = true;
    }
    return learnt;
  }

  static void count(Stats& stats, const Publisher::Stats& of) {
    stats.frames_sent += of.frames_sent;
    stats.bytes_sent += of.payload_bytes;
    stats.dropped += of.frames_dropped;
    stats.unusable += of.dropped_for[static_cast<std::size_t>(Publisher::DropReason::kUnusable)];
  }

  Result<void> check(const Frame& frame) const {
    if (frame.points.empty() || frame.points.size() % 3 != 0)
      return fail(ErrorCode::kInvalidArgument, "points must be 3 numbers for each, and there must be some");
    if (!frame.velocities.empty() && frame.velocities.size() != frame.points.size())
      return fail(ErrorCode::kInvalidArgument, "velocities must be 3 numbers for each point");
    const std::size_t scalars = options_.publisher.scalars.size() * frame.points.size() / 3;
    if (frame.scalars.size() != scalars)
      return fail(ErrorCode::kInvalidArgument, std::to_string(scalars) + " values of scalars were announced, " +
                                                   std::to_string(frame.scalars.size()) + " are given");
    if (frame.time_s && !(std::abs(*frame.time_s) < 1e11))
      return fail(ErrorCode::kInvalidArgument, "the time is not a number of seconds below 1e11");
    return {};
  }

  /// Compares the topology by content, and asks for a bake where it is another. REQUIRES: mutex_ is held.
  Result<void> recognise(const Frame& frame) {
    const std::size_t n = frame.points.size() / 3;
    const bool first = stats_.topologies == 0;
    const bool same_faces =
        frame.as_before ? !first
                        : !first && equal(frame.corners, topology_.corners) && equal(frame.offsets, topology_.offsets);
    if (same_faces && n == topology_.points) {
      if (frame.velocities.empty() == topology_.velocities)
        return fail(ErrorCode::kInvalidArgument, "velocities must come with all poses of a surface or with none");
      return {};
    }
    if (frame.as_before && !topology_.corners.empty())
      return fail(ErrorCode::kInvalidArgument, std::to_string(n) + " points instead of " +
                                                   std::to_string(topology_.points) + ": give the faces as well");
    if (!first && !options_.rebake)
      return fail(ErrorCode::kInvalidArgument,
                  "the topology is not the one of the first pose, and on_topology is raise");
    Topology topology{{}, {}, n, !frame.velocities.empty()};
    if (!frame.as_before) {
      topology.corners.assign(frame.corners.begin(), frame.corners.end());
      topology.offsets.assign(frame.offsets.begin(), frame.offsets.end());
    }
    auto job = job_of(frame, topology);
    if (!job) return job.error();
    topology_ = std::move(topology);
    ++stats_.topologies;
    failure_.reset();
    stage_.clear();
    wanted_ = std::move(*job);
    wake_.notify_all();
    return {};
  }

  Result<Job> job_of(const Frame& frame, const Topology& topology) const {
    Job job;
    StreamPose rest;
    if (const auto copied = copy(frame, rest); !copied) return copied.error();
    for (std::size_t i = 0; i < rest.points.size(); i += 3)
      job.surface.positions.push_back({rest.points[i], rest.points[i + 1], rest.points[i + 2]});
    if (!topology.offsets.empty()) {
      auto faces = fanned(topology.corners, topology.offsets);
      if (!faces) return faces.error();
      job.surface.faces = std::move(*faces);
    } else {
      if (topology.corners.size() % 3 != 0)
        return fail(ErrorCode::kInvalidArgument, "triangles must have 3 corners each; polygons need offsets");
      for (std::size_t i = 0; i < topology.corners.size(); i += 3)
        job.surface.faces.push_back({topology.corners[i], topology.corners[i + 1], topology.corners[i + 2]});
    }
    if (const auto valid = validate_surface(job.surface); !valid) return valid.error();
    return job;
  }

  Result<void> copy(const Frame& frame, StreamPose& pose) const {
    if (const auto good = turned(frame.points, pose.points); !good) return in_context("points", good.error());
    if (const auto good = turned(frame.velocities, pose.velocities); !good)
      return in_context("velocities", good.error());
    pose.scalars.assign(frame.scalars.begin(), frame.scalars.end());
    float none = 0;
    for (const float value : frame.scalars) none += 0 * value;
    pose.held = false;
    if (none == 0) return {};
    const std::vector<Scalar>& scalars = options_.publisher.scalars;
    const auto bad = static_cast<std::size_t>(
        std::find_if(pose.scalars.begin(), pose.scalars.end(), [](float x) { return !std::isfinite(x); }) -
        pose.scalars.begin());
    return fail(ErrorCode::kInvalidArgument, "scalar " + scalars[bad % scalars.size()].name + " of point " +
                                                 std::to_string(bad / scalars.size()) + " is not finite");
  }

  Result<void> turned(std::span<const float> from, std::vector<float>& to) const {
    const auto scale = static_cast<float>(options_.scale);
    to.resize(from.size());
    float none = 0;  // a sum of zeros, unless a number is not finite
    for (std::size_t i = 0; i < from.size(); i += 3) {
      const float x = scale * from[i], y = scale * from[i + 1], z = scale * from[i + 2];
      none += 0 * x + 0 * y + 0 * z;
      to[i] = x;
      to[i + 1] = options_.z_up ? z : y;
      to[i + 2] = options_.z_up ? -y : z;
    }
    if (none == 0) return {};
    const auto bad = std::find_if(to.begin(), to.end(), [](float x) { return !std::isfinite(x); });
    return fail(ErrorCode::kInvalidArgument, "number " + std::to_string((bad - to.begin()) / 3) + " is not finite");
  }

  // All below REQUIRE: mutex_ is held.

  /// Before anything goes out: the pose of now is the one to begin with.
  void begin_with(StreamPose pose) {
    const TimeUs now = steady_now_us();
    while (queue_.size() > 0) {
      ++stats_.superseded;
      (void)queue_.take(now);
    }
    pose.held = true;
    add(std::move(pose), now);
  }

  void add(StreamPose pose, TimeUs now_us) {
    auto left = queue_.add(std::move(pose), now_us);
    if (!left) return;
    ++stats_.early;
    spare_ = std::move(*left);
  }

  void run() {
    std::unique_lock lock(mutex_);
    while (true) {
      if (wanted_ && !stopped_) {
        begin_bake(lock);
        continue;
      }
      const auto next_us = due_us();
      if (stopped_ && (!next_us || steady_now_us() >= end_us_)) break;
      if (!next_us) {
        wake_.wait(lock);
      } else if (const TimeUs wait_us = *next_us - steady_now_us(); wait_us > 0) {
        wake_.wait_for(lock, std::chrono::microseconds(wait_us));
      } else {
        send_next(lock);
      }
    }
    lock.unlock();
    if (baker_.joinable()) baker_.join();
    lock.lock();
    const auto last = std::exchange(publisher_, nullptr);
    lock.unlock();
  }

  /// When there is something to send, or to see whether it can be sent; nothing: not before something happens.
  std::optional<TimeUs> due_us() {
    if (!ready_ || wanted_ || queue_.size() == 0) return std::nullopt;
    const TimeUs now = steady_now_us();
    if (publisher_->state() == Publisher::State::kLive) return queue_.due_us(now);
    if (stopped_) return std::nullopt;
    return now + std::chrono::duration_cast<std::chrono::microseconds>(kLivePoll).count();
  }

  void send_next(std::unique_lock<std::mutex>& lock) {
    StreamPose pose = queue_.take(steady_now_us());
    if (pose.held) {
      pose.capture_us = std::max(pose.capture_us, steady_now_us());
      if (queue_.size() > 0) pose.capture_us = std::min(pose.capture_us, queue_.front().capture_us - 1);
      time_.pass(pose.capture_us);
    }
    auto publisher = publisher_;
    std::vector<Scalar> scalars = scalars_;
    lock.unlock();
    if (learn(scalars, pose.scalars)) {
      publisher.reset();
      lock.lock();
      scalars_ = std::move(scalars);
      announce_anew(lock, std::move(pose));
      return;
    }
    const auto sent = publisher->send_pose({pose.points, pose.velocities, pose.scalars}, pose.capture_us);
    if (!sent) log(log_, LogLevel::kError, "pose not sent: " + sent.error().message);
    lock.lock();
    if (!sent) {
      ++stats_.dropped;
      ++stats_.unusable;
    }
    spare_ = std::move(pose);
  }

  /// Streams state the ranges of scalars at their beginning: with those learnt from a pose it begins again.
  void announce_anew(std::unique_lock<std::mutex>& lock, StreamPose pose) {
    wake_.wait(lock, [this] { return !changing_; });
    if (is_overtaken()) return;
    changing_ = true;
    ready_ = false;
    if (queue_.size() > 0)
      ++stats_.superseded;
    else
      begin_with(std::move(pose));
    retire(lock);
    if (auto made = create_publisher(lock)) {
      publisher_ = std::move(*made);
      if (!baking_) publisher_->learn(options_.publisher.learn);
      ready_ = true;
    } else {
      failure_ = made.error();
    }
    changing_ = false;
    wake_.notify_all();
  }

  /// Ends the publisher, with lock released.
  void retire(std::unique_lock<std::mutex>& lock) {
    auto before = std::exchange(publisher_, nullptr);
    if (before) count(stats_, before->stats());
    lock.unlock();
    before.reset();
    lock.lock();
  }

  /// Of the newest asset, with lock released.
  Result<std::unique_ptr<Publisher>> create_publisher(std::unique_lock<std::mutex>& lock) {
    PublisherOptions options = options_.publisher;
    options.velocities = topology_.velocities;
    options.scalars = scalars_;
    options.learn = LearnUse::kOff;  // Not from a part of the basis.
    const auto asset = asset_;
    const auto encoded = encoded_;
    lock.unlock();
    auto made = Publisher::create(std::move(options), asset, encoded, log_);
    lock.lock();
    return made;
  }

  /// On a thread of its own, as a part of the basis is streamed with while the rest is made.
  void begin_bake(std::unique_lock<std::mutex>& lock) {
    if (baker_.joinable()) {  // It sees that another surface is wanted, and ends.
      lock.unlock();
      baker_.join();
      lock.lock();
      if (stopped_) return;
    }
    ready_ = false;
    baking_ = true;
    baker_ = std::thread([this, job = std::move(*std::exchange(wanted_, std::nullopt))]() mutable {
      job.loose = is_triangle_soup(job.surface);
      bake_for(job);
    });
  }

  void bake_for(const Job& job) {
    if (job.loose) log(log_, LogLevel::kWarning, "the faces share no vertices: weld them");
    BakeOptions options = options_.bake;
    Result<void> begun;
    options.first = [&](BakeResult& first) { begun = stream_with(job, std::move(first), false); };
    auto baked = bake(job.surface, options, options_.cache_dir, [this](double fraction, std::string_view stage) {
      std::unique_lock lock(mutex_);
      stage_ = std::string(stage) + formatted(", %.0f %%", 100 * fraction);
      const auto publisher = ready_ ? publisher_ : nullptr;
      const bool goes_on = !is_overtaken();
      lock.unlock();
      if (publisher) publisher->show_progress(fraction);
      return goes_on;
    });
    if (begun) begun = baked ? stream_with(job, std::move(*baked), true) : baked.error();
    const std::lock_guard lock(mutex_);
    baking_ = false;
    if (is_overtaken()) return;
    if (!begun && ready_) log(log_, LogLevel::kError, "the stream stays coarse: " + begun.error().message);
    if (!begun && !ready_) failure_ = begun.error();
    wake_.notify_all();
  }

  /// REQUIRES: mutex_ is held.
  bool is_overtaken() const { return wanted_ || stopped_; }

  /// Takes the stream from the surface before once there is another; another asset of the same continues it.
  Result<void> stream_with(const Job& job, BakeResult baked, bool whole) {
    const auto asset = std::make_shared<const Asset>(std::move(baked.asset));
    const auto encoded = std::make_shared<const EncodedAsset>(std::move(baked.encoded));
    std::unique_lock lock(mutex_);
    wake_.wait(lock, [this] { return !changing_; });
    if (is_overtaken()) return fail(ErrorCode::kCancelled, "another topology came");
    changing_ = true;
    asset_ = asset;
    encoded_ = encoded;
    const auto streamed = ready_ ? go_over(lock) : begin(lock, job, whole);
    if (streamed && whole) publisher_->learn(options_.publisher.learn);
    changing_ = false;
    wake_.notify_all();
    return streamed;
  }

  Result<void> go_over(std::unique_lock<std::mutex>& lock) {
    auto publisher = publisher_;
    const auto asset = asset_;
    const auto encoded = encoded_;
    lock.unlock();
    auto changed = publisher->change_to(asset, encoded);
    publisher.reset();
    lock.lock();
    return changed;
  }

  Result<void> begin(std::unique_lock<std::mutex>& lock, const Job& job, bool whole) {
    retire(lock);
    if (queue_.size() > 0) (void)learn(scalars_, queue_.front().scalars);
    auto made = create_publisher(lock);
    if (!made) return made.error();
    if (is_overtaken()) return fail(ErrorCode::kCancelled, "another topology came");
    publisher_ = std::move(*made);
    ready_ = true;
    baking_ = !whole;
    stats_.loose_faces = job.loose;
    ++stats_.bakes;
    return {};
  }

  const SurfaceStreamOptions options_;
  const LogSink log_;
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  // GUARDED_BY(mutex_):
  bool stopped_ = false;
  TimeUs end_us_ = 0;
  Topology topology_;
  std::optional<Job> wanted_;  ///< The surface to bake next.
  bool baking_ = false;
  bool ready_ = false;  ///< publisher_ is of topology_, if nothing is wanted.
  std::string stage_;
  std::optional<Error> failure_;  ///< Of the bake of topology_.
  std::shared_ptr<Publisher> publisher_;
  std::shared_ptr<const Asset> asset_;  ///< The newest of topology_.
  std::shared_ptr<const EncodedAsset> encoded_;
  bool changing_ = false;        ///< One thread at a time gives the publisher another asset, or makes another one.
  std::vector<Scalar> scalars_;  ///< As the present publisher announces them.
  PacedQueue<StreamPose> queue_;
  HostTime time_;
  StreamPose spare_;  ///< Its memory is used again.
  Stats stats_;
  std::thread baker_;   ///< For the worker's thread alone.
  std::thread worker_;  ///< Last: it uses all above.
};

/// Lives where it was made: of threads and connections a forked process has no more than the memory.
class StreamOfProcess final : public SurfaceStream {
 public:
  explicit StreamOfProcess(std::unique_ptr<SurfaceStream> stream) : stream_(std::move(stream)) {}
  ~StreamOfProcess() override {
    if (is_elsewhere()) (void)stream_.release();
  }
  Result<Sent> send(const Frame& frame) override {
    if (is_elsewhere()) return elsewhere();
    return stream_->send(frame);
  }
  Result<bool> wait_live(milliseconds timeout) override {
    if (is_elsewhere()) return elsewhere();
    return stream_->wait_live(timeout);
  }
  Stats stats() const override {
    if (!is_elsewhere()) return stream_->stats();
    Stats none;
    none.detail = elsewhere().message;
    return none;
  }

 private:
  bool is_elsewhere() const { return ::getpid() != process_; }
  Error elsewhere() const {
    return fail(ErrorCode::kUnsupported, "this stream belongs to process " + std::to_string(process_) +
                                             ", which forked this one: make one here, of another name");
  }
  const pid_t process_ = ::getpid();
  std::unique_ptr<SurfaceStream> stream_;
};

}  // namespace

Result<std::unique_ptr<SurfaceStream>> SurfaceStream::create(SurfaceStreamOptions options, LogSink log) {
  if (!(options.max_rate_hz > 0))
    return fail(ErrorCode::kInvalidArgument, "max_rate_hz must be above 0; infinity is no limit");
  if (!(options.scale > 0) || !std::isfinite(options.scale))
    return fail(ErrorCode::kInvalidArgument, "the scale must be a number above 0");
  if (options.max_rate_hz <= kMostAnnouncedHz) options.publisher.key_rate_hz = options.max_rate_hz;
  if (const auto usable = check_options(options.publisher); !usable) return usable.error();
  if (const auto url = stream_url(options.publisher.url, options.publisher.credentials, {}); !url) return url.error();
  std::unique_ptr<SurfaceStream> made = std::make_unique<ThreadedStream>(std::move(options), std::move(log));
  return std::unique_ptr<SurfaceStream>(std::make_unique<StreamOfProcess>(std::move(made)));
}

}  // namespace eigencast
