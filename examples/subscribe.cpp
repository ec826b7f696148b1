// SPDX-License-Identifier: MIT
// Watches a stream from a loop of your own: subscribe http://127.0.0.1:7490/sheet [POSES]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <eigencast/eigencast.hpp>
#include <exception>

int main(int argc, char** argv) {
  const char* url = argc > 1 ? argv[1] : "http://127.0.0.1:7490/sheet";
  const long poses = argc > 2 ? std::atol(argv[2]) : 300;
  try {
    eigencast::Subscriber subscriber(url);
    int silent_seconds = 0;
    for (long i = 0; i < poses;) {
      if (!subscriber.next(std::chrono::seconds(1))) {  // Also while it connects: it keeps trying.
        if (++silent_seconds > 60) throw std::runtime_error("no pose within a minute");
        continue;
      }
      silent_seconds = 0;
      // Draw it, measure it, simulate with it: positions, normals and triangles at the detail you can afford.
      const ec_surface surface = subscriber.surface(0.5);
      float low = surface.positions[1], high = surface.positions[1];
      for (std::uint32_t v = 0; v < surface.vertex_count; ++v) {
        low = std::min(low, surface.positions[3 * v + 1]);
        high = std::max(high, surface.positions[3 * v + 1]);
      }
      std::printf("key %llu%s: %u vertices, %u triangles, height %.3f to %.3f\n",
                  static_cast<unsigned long long>(surface.sequence), surface.interpolated ? " (between)" : "",
                  surface.vertex_count, surface.triangle_count, low, high);
      ++i;
    }
    const auto stats = subscriber.stats();
    std::printf("received %llu keys and %llu interpolated poses, %llu bytes\n",
                static_cast<unsigned long long>(stats.keys), static_cast<unsigned long long>(stats.interpolated),
                static_cast<unsigned long long>(stats.bytes_received));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "subscribe: %s\n", error.what());
    return 1;
  }
}
