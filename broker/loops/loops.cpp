// SPDX-License-Identifier: MIT
#include "broker/loops/loops.h"

#include <sched.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <thread>
#include <utility>

#include "broker/connections/connection.h"
#include "broker/sockets/disk_threads.h"
#include "common/core/clock.h"

namespace eigencast::broker {
namespace {

// Poses of many streams due within this gap are pumped together.
constexpr TimeUs kMinPumpGapUs = 1000;
constexpr std::chrono::milliseconds kNewsEvery{100};  // Of rooms and moments.
constexpr TimeUs kVisitUs = 500;  // Then frames come first, however many connections wait for their turn.
constexpr TimeUs kClusterPrepareUs = 5'000'000;  // What viewers at other brokers have to fetch a next asset.

Hub::Settings hub_settings(const Config& config, std::vector<StreamTap*> taps, std::shared_ptr<StreamIds> ids,
                           std::shared_ptr<StreamMemory> memory, std::function<void(Stream&)> on_opened) {
  return {.max_streams = static_cast<std::size_t>(config.limits.max_streams),
          .stream = {.max_span_us = config.frames.max_span_ms * 1000,
                     .max_watchers = static_cast<std::uint32_t>(config.limits.max_subscribers_per_stream),
                     .max_profiles = static_cast<std::size_t>(config.limits.max_profiles_per_stream),
                     .taps = std::move(taps),
                     .max_ahead_us = config.frames.max_ahead_ms * 1000,
                     .max_bytes = config.limits.max_stream_bytes,
                     .max_memory_bytes = config.memory.max_bytes,
                     .memory = std::move(memory),
                     .min_prepare_us = config.backbone.servers.empty() ? TimeUs{0} : kClusterPrepareUs},
          .ids = std::move(ids),
          .on_opened = std::move(on_opened)};
}

Turn::Settings turn_settings(const Config& config) {
  return {.gathering = {.tick_us = config.frames.gather_ms * 1000,
                        .above_per_second = static_cast<std::uint64_t>(config.frames.gather_above)},
          .uring = config.sockets.writes != "epoll"};
}
constexpr std::size_t kMaxLoops = 256;  // As server.threads (config/settings.def).
constexpr std::size_t kMaxSets = 64;    // The kernel refuses a set that is smaller than its own.

std::size_t cores() {
  for (std::vector<cpu_set_t> allowed(1); allowed.size() <= kMaxSets; allowed.resize(2 * allowed.size())) {
    const std::size_t bytes = allowed.size() * sizeof(cpu_set_t);
    if (::sched_getaffinity(0, bytes, allowed.data()) == 0) {
      return static_cast<std::size_t>(CPU_COUNT_S(bytes, allowed.data()));
    }
  }
  return 1;
}

}  // namespace

Loop::Loop(const Config& config, const SharedContext& shared, const Siblings& siblings, std::vector<StreamTap*> taps,
           std::function<void(Stream&)> on_opened)
    : hub_(hub_settings(config, std::move(taps), siblings.ids, siblings.memory, std::move(on_opened))),
      memory_reads_(reads_on(shared.disk)),
      past_reads_(reads_on(shared.past)),
      context_{shared,
               io_,
               config,
               hub_,
               turn_,
               newcomers_,
               viewers_,
               siblings.loops,
               siblings.last_connection_id,
               memory_reads_,
               past_reads_,
               siblings.rooms,
               siblings.moments},
      io_(1),
      turn_(io_, turn_settings(config), shared.log,
            [this] {
              const bool more = hub_.deliver(Turn::kSliceUs);
              arm_schedule();
              return more;
            }),
      newcomers_(io_),
      viewers_(io_),
      schedule_(io_.get_executor()),
      tick_(io_.get_executor()),
      beat_(io_.get_executor()) {
  context_.arm_beat = [this] { arm_beat(); };
}

FairReads Loop::reads_on(DiskThreads& threads) {
  return {[this, &threads](FairReads::Work work) {
            threads.post({}, [guard = asio::make_work_guard(io_), work = std::move(work)] { work(); });
          },
          [this](FairReads::Work work) { asio::post(io_, std::move(work)); }};
}

void Loop::begin() {
  run_when_woken(kPassingOn);
  turn_.begin();
  context_.started_us = steady_now_us();
  tick();
}

void Loop::run() {
  bool ended = false;
  while (!ended) {
    guarded([&] {
      io_.run();  // A stopped loop returns at once.
      ended = true;
    });
  }
}

void Loop::guarded(const std::function<void()>& work) noexcept {
  try {
    work();
  } catch (const std::exception& exception) {
    try {
      log(context_.log, LogLevel::kError,
          std::string("a request was given up, the broker goes on: ") + exception.what());
    } catch (const std::exception&) {  // No memory for the line.
    }
  }
}

void Loop::arm_schedule() {
  const auto due = hub_.next_due_us();
  if (!due || (scheduled_us_ && *scheduled_us_ <= *due)) return;
  scheduled_us_ = due;
  const TimeUs at_us = std::max(*due, pumped_us_ + kMinPumpGapUs);
  schedule_.expires_at(std::chrono::steady_clock::time_point(std::chrono::microseconds(at_us)));
  schedule_.async_wait([this](ErrorOf error) {
    if (error) return;
    scheduled_us_.reset();
    pumped_us_ = steady_now_us();
    guarded([this] { hub_.pump(pumped_us_); });
    turn_.arm();
  });
}

void Loop::tick() {
  run_after(tick_, std::chrono::seconds(1), [this] { tick(); });
  if (ticked_ == 0) tick_some();
}

void Loop::tick_some() {
  visit_some(ticked_, context_.connections, &Connection::tick, &Loop::tick_some);
}

void Loop::visit_some(std::uint64_t& last, const Connections& those, void (Connection::*visit)(),
                      void (Loop::*again)()) {
  const TimeUs until_us = steady_now_us() + kVisitUs;
  do {
    const auto next = those.upper_bound(last);
    last = next == those.end() ? 0 : next->first;
    if (last == 0) return;
    guarded([connection = next->second, visit] { (connection->*visit)(); });
  } while (steady_now_us() < until_us);
  asio::post(io_, [this, again] { (this->*again)(); });
}

void Loop::arm_beat() {
  if (std::exchange(beat_armed_, true)) return;
  run_after(beat_, kNewsEvery, [this] {
    beat_armed_ = false;
    if (context_.on_beat.empty()) return;
    arm_beat();
    if (told_ == 0) tell_some();
  });
}

void Loop::tell_some() {
  visit_some(told_, context_.on_beat, &Connection::beat, &Loop::tell_some);
}

struct Loops::Other {
  explicit Other(MirrorSet::Environment around) : mirrors(std::move(around)) {}
  MirrorSet mirrors;
  std::unique_ptr<Loop> loop;
  std::atomic<std::uint64_t> taken{0};  ///< Processed mirror events.
  std::thread thread;
};

Loops::Loops(const Config& config, const SharedContext& shared, std::vector<StreamTap*> taps)
    : ids_(std::make_shared<StreamIds>(config.limits.max_waiting_streams)) {
  const auto threads = static_cast<std::size_t>(config.server.threads);
  const std::size_t others = (threads == 0 ? std::min(cores(), kMaxLoops) : threads) - 1;
  if (others > 0) {
    origin_ = std::make_unique<MirrorOrigin>(others, origin_environment());
    taps.push_back(origin_.get());
  }
  const Loop::Siblings siblings{*this, ids_, std::make_shared<StreamMemory>(), last_connection_id_, rooms_, moments_};
  first_ = std::make_unique<Loop>(config, shared, siblings, std::move(taps), nullptr);
  for (std::size_t i = 0; i < others; ++i) {
    Other& other = *others_.emplace_back(std::make_unique<Other>(mirror_environment(i)));
    const auto on_opened = [&other](Stream& stream) { other.mirrors.on_opened(stream); };
    other.loop = std::make_unique<Loop>(config, shared, siblings, std::vector<StreamTap*>{}, on_opened);
  }
}

Loops::~Loops() {
  stop();
}

MirrorOrigin::Environment Loops::origin_environment() {
  return {[this](std::size_t index, MirrorEvents events) {
            Other& other = *others_[index];
            asio::post(other.loop->io(), [&other, events = std::move(events)] {
              for (const MirrorEvent& event : events) other.taken += cost_of(event);
              other.mirrors.take(other.loop->hub(), events, other.loop->context().turn.now_us());
            });
          },
          [this](std::size_t index) { return others_[index]->taken.load(); },
          [this] { asio::post(first_->io(), [this] { origin_->flush(); }); }};
}

MirrorSet::Environment Loops::mirror_environment(std::size_t index) {
  return {[this, index](MirrorRequests requests) {
            asio::post(first_->io(), [this, index, requests = std::move(requests)] {
              origin_->take(first_->hub(), index, requests);
            });
          },
          [this, index] {
            Other& other = *others_[index];
            asio::post(other.loop->io(), [&other] { other.mirrors.flush(other.loop->hub()); });
          }};
}

void Loops::start() {
  for (const auto& other : others_) {
    other->thread = std::thread([loop = other->loop.get()] {
      loop->begin();
      loop->run();
    });
  }
}

void Loops::stop() {
  for (const auto& other : others_) other->loop->stop();
  for (const auto& other : others_) {
    if (other->thread.joinable()) other->thread.join();
  }
}

Context& Loops::least_busy() {
  Context* least = &first_->context();
  std::uint64_t fewest = least->connection_count - 1;  // Without the viewer itself.
  for (const auto& other : others_) {
    Context& context = other->loop->context();
    const std::uint64_t open = context.connection_count;
    if (open >= fewest) continue;
    fewest = open;
    least = &context;
  }
  return *least;
}

std::vector<std::uint64_t> Loops::connections() const {
  std::vector<std::uint64_t> all{first_->context().connection_count};
  for (const auto& other : others_) all.push_back(other->loop->context().connection_count);
  return all;
}

std::uint64_t Loops::connections_total() const {
  return first_->context().connection_count + connections_of_others();
}

std::uint64_t Loops::connections_of_others() const {
  std::uint64_t total = 0;
  for (const auto& other : others_) total += other->loop->context().connection_count;
  return total;
}

void Loops::for_each_loop(std::function<void(Context&)> work, std::function<void()> done) {
  work(first_->context());
  if (others_.empty()) return done();
  relay(std::move(work), std::move(done), 0);
}

void Loops::relay(std::function<void(Context&)> work, std::function<void()> done, std::size_t next) {
  if (next == others_.size()) return asio::post(first_->io(), std::move(done));
  Loop& loop = *others_[next]->loop;
  asio::post(loop.io(), [this, work = std::move(work), done = std::move(done), &loop, next]() mutable {
    loop.guarded([&] { work(loop.context()); });  // It goes on even if the work throws.
    relay(std::move(work), std::move(done), next + 1);
  });
}

void Loops::tick() {
  if (origin_) origin_->flush();
}

}  // namespace eigencast::broker
