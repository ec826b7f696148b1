// SPDX-License-Identifier: MIT
// Publishes a waving sheet from a loop of your own: publish http://127.0.0.1:7490/sheet [SECONDS]
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <eigencast/eigencast.hpp>
#include <exception>
#include <thread>
#include <vector>

int main(int argc, char** argv) {
  const char* url = argc > 1 ? argv[1] : "http://127.0.0.1:7490/sheet";
  const double seconds = argc > 2 ? std::atof(argv[2]) : 3600;
  constexpr std::uint32_t kSide = 60;
  try {
    // The surface at rest: any triangle mesh will do; without faces it is a point cloud.
    std::vector<double> rest;
    std::vector<std::uint32_t> faces;
    for (std::uint32_t y = 0; y < kSide; ++y) {
      for (std::uint32_t x = 0; x < kSide; ++x) {
        rest.insert(rest.end(), {x / 59.0, 0, y / 59.0});
        const std::uint32_t i = y * kSide + x;
        if (x + 1 == kSide || y + 1 == kSide) continue;
        faces.insert(faces.end(), {i, i + kSide, i + 1, i + 1, i + kSide, i + kSide + 1});
      }
    }
    const auto asset = eigencast::Asset::bake(rest, faces, {.rank = 100});
    eigencast::Publisher publisher(url, asset, {.key_rate_hz = 20});

    // Your simulation: new positions at each step, in the same order.
    std::vector<float> positions(rest.begin(), rest.end());
    const auto start = std::chrono::steady_clock::now();
    for (int frame = 0; frame < seconds * 20; ++frame) {
      for (std::size_t i = 0; i < positions.size(); i += 3) {
        positions[i + 1] = static_cast<float>(0.1 * std::sin(6 * rest[i] + frame * 0.15) * std::cos(4 * rest[i + 2]));
      }
      if (publisher.send(positions) == EC_DISCONNECTED && frame % 20 == 0) std::puts("not connected yet");
      std::this_thread::sleep_until(start + std::chrono::milliseconds(50) * (frame + 1));
    }
    const auto stats = publisher.stats();
    std::printf("sent %llu poses, %llu bytes\n", static_cast<unsigned long long>(stats.frames_sent),
                static_cast<unsigned long long>(stats.bytes_sent));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "publish: %s\n", error.what());
    return 1;
  }
}
