// SPDX-License-Identifier: MIT
#include "broker/loops/loops.h"

#include <sched.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <thread>
#include <utility>

namespace eigencast::broker {
namespace {

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

std::size_t loops_wanted(const Config& config) {
  return config.server.threads == 0 ? std::min(cores(), kMaxLoops) : static_cast<std::size_t>(config.server.threads);
}

}  // namespace

struct Loops::Other {
  explicit Other(MirrorSet::Environment around) : mirrors(std::move(around)) {}
  MirrorSet mirrors;
  std::unique_ptr<Loop> loop;
  std::atomic<std::uint64_t> taken{0};  ///< Processed mirror events.
  std::thread thread;
};

Loops::Loops(const Config& config, const SharedContext& shared, std::vector<StreamTap*> taps) {
  const std::size_t others = loops_wanted(config) - 1;
  if (others > 0) {
    origin_ = std::make_unique<MirrorOrigin>(others, origin_environment());
    taps.push_back(origin_.get());
  }
  first_ = make_loop(config, shared, std::move(taps), {});
  for (std::size_t i = 0; i < others; ++i) {
    others_.push_back(std::make_unique<Other>(mirror_environment(i)));
    MirrorSet& mirrors = others_.back()->mirrors;
    others_.back()->loop = make_loop(config, shared, {}, [&mirrors](Stream& stream) { mirrors.on_opened(stream); });
  }
}

Loops::~Loops() {
  stop();
}

std::unique_ptr<Loop> Loops::make_loop(const Config& config, const SharedContext& shared, std::vector<StreamTap*> taps,
                                       std::function<void(Stream&)> on_opened) {
  return std::make_unique<Loop>(config, shared, Loop::Siblings{*this, ids_, last_connection_id_}, std::move(taps),
                                std::move(on_opened));
}

MirrorOrigin::Environment Loops::origin_environment() {
  return {[this](std::size_t index, MirrorEvents events) {
            Other& other = *others_[index];
            asio::post(other.loop->io(), [&other, events = std::move(events)] {
              other.taken += events.size();
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
  relay(std::make_shared<RelayTask>(RelayTask{std::move(work), std::move(done)}), 0);
}

void Loops::relay(std::shared_ptr<RelayTask> task, std::size_t next) {
  if (next == others_.size()) return asio::post(first_->io(), [task = std::move(task)] { task->done(); });
  Loop& loop = *others_[next]->loop;
  asio::post(loop.io(), [this, task = std::move(task), &loop, next]() mutable {
    loop.guarded([&] { task->work(loop.context()); });  // The task continues even if the work throws.
    relay(std::move(task), next + 1);
  });
}

void Loops::tick() {
  if (origin_) origin_->flush();
}

}  // namespace eigencast::broker
