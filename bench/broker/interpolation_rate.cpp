// SPDX-License-Identifier: MIT
//
// interpolation_rate FRAMES [STREAMS [KEYS_PER_SECOND]]: what interpolating costs a broker without its sockets: keys
// are decoded, poses paced, made, coded and framed, for one viewer of each stream that gets them in no time. FRAMES is
// a file of a join and keys, each behind its length (4 bytes), as interpolation.py keeps them.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "broker/relay/hub.h"

namespace {

using namespace eigencast;
using namespace eigencast::broker;

constexpr TimeUs kPumpGapUs = 1000;  // As broker/broker.cpp.

class Counter final : public Watcher {
 public:
  void on_stream_changed(const Stream&, bool) override {}
  void on_frames(const Stream&, std::span<const FramePtr> received) override {
    for (const FramePtr& frame : received) ++frames, bytes += frame->wire.size();
  }
  void on_trace(const std::shared_ptr<const std::string>&) override {}
  std::size_t frames = 0, bytes = 0;
};

std::vector<Bytes> frames_of(const char* path) {
  std::ifstream file(path, std::ios::binary);
  const Bytes all((std::istreambuf_iterator<char>(file)), {});
  std::vector<Bytes> frames;
  ByteReader reader(all);
  while (!reader.finished() && !reader.failed()) {
    const ByteView frame = reader.bytes(reader.u32());
    frames.emplace_back(frame.begin(), frame.end());
  }
  if (reader.failed() || frames.size() < 2) {
    std::fprintf(stderr, "interpolation_rate: %s holds no frames\n", path);
    std::exit(1);
  }
  return frames;
}

double cpu_seconds() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_nsec) * 1e-9;
}

struct Cost {
  double of_core = 0;  ///< While the keys come in real time.
  double frames_per_s = 0;
};

/// Everything happens at its time on a clock of its own, as fast as it can be done.
Cost run(const std::vector<Bytes>& keys, std::size_t streams, double rate, const Profile& profile) {
  Hub hub({});
  std::vector<Counter> viewers(streams);
  struct Sender final : PublisherLink {
    void on_watcher_count(std::uint32_t) override {}
  };
  std::vector<Sender> senders(streams);
  std::vector<Stream*> all;
  control::Announce announce;
  announce.format = {200, 3, {14, 54, 104, 200}, "quantised", 0, 1'000'000};
  announce.key_rate_hz = rate;
  for (std::size_t i = 0; i < streams; ++i) {
    all.push_back(hub.open("s" + std::to_string(i)).value());
    if (!all[i]->claim(senders[i]) || !all[i]->announce(announce, 1) || !all[i]->watch(viewers[i], profile))
      std::abort();
  }
  const double apart_us = 1e6 / rate / static_cast<double>(streams);
  TimeUs pumped_us = 0;
  const auto pump_until = [&](TimeUs now_us) {
    for (auto due = hub.next_due_us(); due && std::max(*due, pumped_us + kPumpGapUs) <= now_us;
         due = hub.next_due_us()) {
      pumped_us = std::max(*due, pumped_us + kPumpGapUs);
      hub.pump(pumped_us);
      hub.deliver();
    }
  };
  double begun = 0;
  const std::size_t settled = keys.size() / 4;
  for (std::size_t key = 0; key < keys.size(); ++key) {
    if (key == settled) {
      begun = cpu_seconds();
      for (Counter& viewer : viewers) viewer = {};
    }
    for (std::size_t i = 0; i < streams; ++i) {
      const auto now_us = static_cast<TimeUs>(apart_us * static_cast<double>(key * streams + i));
      pump_until(now_us);
      if (const auto taken = all[i]->take_frame(keys[key], now_us); !taken) {
        std::fprintf(stderr, "interpolation_rate: %s\n", taken.error().message.c_str());
        std::exit(1);
      }
      hub.mark_dirty(*all[i]);
      hub.deliver();
    }
  }
  const double took_s = static_cast<double>(keys.size() - settled) / rate;
  const double spent = cpu_seconds() - begun;
  std::size_t frames = 0;
  for (const Counter& viewer : viewers) frames += viewer.frames;
  for (std::size_t i = 0; i < streams; ++i) {
    all[i]->unwatch(viewers[i]);
    all[i]->release(senders[i]);
  }
  return {spent / took_s, static_cast<double>(frames) / took_s};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: interpolation_rate FRAMES [STREAMS [KEYS_PER_SECOND]]\n");
    return 2;
  }
  const auto keys = frames_of(argv[1]);
  const std::size_t streams = argc > 2 ? std::strtoul(argv[2], nullptr, 10) : 100;
  const double rate = argc > 3 ? std::atof(argv[3]) : 30;
  for (const char* query : {"rate=raw", "", "scheme=catmull-rom"}) {
    const Profile profile = profile_from_query(query).value();
    std::vector<Cost> costs;
    for (int i = 0; i < 5; ++i) costs.push_back(run(keys, streams, rate, profile));
    std::nth_element(costs.begin(), costs.begin() + 2, costs.end(),
                     [](const Cost& a, const Cost& b) { return a.of_core < b.of_core; });
    std::printf("%zu streams, %g keys/s, %-20s %6.2f %% of one core, %6.0f frames/s\n", streams, rate,
                *query != '\0' ? query : "interpolated, x3", 100 * costs[2].of_core, costs[2].frames_per_s);
  }
  return 0;
}
