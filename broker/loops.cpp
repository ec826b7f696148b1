// SPDX-License-Identifier: MIT
#include "broker/loops.h"

#include <sched.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <thread>
#include <utility>

namespace eigencast::broker {
namespace {

/// As many as anybody may ask for by number (config/settings.def).
constexpr std::size_t kMostLoops = 256;
/// The kernel refuses a set that is smaller than its own, whatever this machine has.
constexpr std::size_t kMostSets = 64;

/// Cores that this process may run on.
std::size_t cores() {
  for (std::vector<cpu_set_t> allowed(1); allowed.size() <= kMostSets; allowed.resize(2 * allowed.size())) {
    const std::size_t bytes = allowed.size() * sizeof(cpu_set_t);
    if (::sched_getaffinity(0, bytes, allowed.data()) == 0) {
      return static_cast<std::size_t>(CPU_COUNT_S(bytes, allowed.data()));
    }
  }
  return 1;
}

std::size_t loops_wanted(const Config& config) {
  return config.server.threads == 0 ? std::min(cores(), kMostLoops) : static_cast<std::size_t>(config.server.threads);
}

}  // namespace

struct Loops::Other {
  explicit Other(Mirrors::Surroundings around) : mirrors(std::move(around)) {}
  Mirrors mirrors;
  std::unique_ptr<Loop> loop;
  std::atomic<std::uint64_t> taken{0};  ///< Events, for Mirrored.
  std::thread thread;
};

Loops::Loops(const Config& config, const Loop::Common& common, std::vector<StreamTap*> taps) {
  const std::size_t others = loops_wanted(config) - 1;
  if (others > 0) {
    mirrored_ = std::make_unique<Mirrored>(others, around_mirrored());
    taps.push_back(mirrored_.get());
  }
  first_ = make_loop(config, common, std::move(taps), {});
  for (std::size_t i = 0; i < others; ++i) {
    others_.push_back(std::make_unique<Other>(around_mirrors(i)));
    Mirrors& mirrors = others_.back()->mirrors;
    others_.back()->loop = make_loop(config, common, {}, [&mirrors](Stream& stream) { mirrors.on_opened(stream); });
  }
}

Loops::~Loops() {
  stop();
}

std::unique_ptr<Loop> Loops::make_loop(const Config& config, const Loop::Common& common, std::vector<StreamTap*> taps,
                                       std::function<void(Stream&)> on_opened) {
  return std::make_unique<Loop>(config, common, Loop::Place{*this, ids_, last_connection_id_}, std::move(taps),
                                std::move(on_opened));
}

Mirrored::Surroundings Loops::around_mirrored() {
  return {[this](std::size_t index, MirrorEvents events) {
            Other& other = *others_[index];
            asio::post(other.loop->io(), [&other, events = std::move(events)] {
              other.taken += events.size();
              other.mirrors.take(other.loop->hub(), events, other.loop->context().turn.now_us());
            });
          },
          [this](std::size_t index) { return others_[index]->taken.load(); },
          [this] { asio::post(first_->io(), [this] { mirrored_->flush(); }); }};
}

Mirrors::Surroundings Loops::around_mirrors(std::size_t index) {
  return {[this, index](MirrorAsks asks) {
            asio::post(first_->io(),
                       [this, index, asks = std::move(asks)] { mirrored_->take(first_->hub(), index, asks); });
          },
          [this, index] {
            Other& other = *others_[index];
            asio::post(other.loop->io(), [&other] { other.mirrors.settle(other.loop->hub()); });
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
  std::uint64_t fewest = least->open - 1;  // It would leave that one.
  for (const auto& other : others_) {
    Context& context = other->loop->context();
    const std::uint64_t open = context.open;
    if (open >= fewest) continue;
    fewest = open;
    least = &context;
  }
  return *least;
}

std::vector<std::uint64_t> Loops::connections() const {
  std::vector<std::uint64_t> all{first_->context().open};
  for (const auto& other : others_) all.push_back(other->loop->context().open);
  return all;
}

std::uint64_t Loops::connections_total() const {
  return first_->context().open + connections_elsewhere();
}

std::uint64_t Loops::connections_elsewhere() const {
  std::uint64_t total = 0;
  for (const auto& other : others_) total += other->loop->context().open;
  return total;
}

void Loops::go_round(std::function<void(Context&)> work, std::function<void()> done) {
  work(first_->context());
  if (others_.empty()) return done();
  pass_on(std::make_shared<Slip>(Slip{std::move(work), std::move(done)}), 0);
}

void Loops::pass_on(std::shared_ptr<Slip> slip, std::size_t next) {
  if (next == others_.size()) return asio::post(first_->io(), [slip = std::move(slip)] { slip->done(); });
  Loop& loop = *others_[next]->loop;
  asio::post(loop.io(), [this, slip = std::move(slip), &loop, next]() mutable {
    loop.guarded([&] { slip->work(loop.context()); });  // The slip comes back to where it began whatever comes of that.
    pass_on(std::move(slip), next + 1);
  });
}

void Loops::tick() {
  if (mirrored_) mirrored_->flush();
}

}  // namespace eigencast::broker
