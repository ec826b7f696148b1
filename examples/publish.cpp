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
    // Any triangle mesh will do; without faces it is a point cloud.
    std::vector<float> positions;
    std::vector<std::uint32_t> faces;
    for (std::uint32_t y = 0; y < kSide; ++y) {
      for (std::uint32_t x = 0; x < kSide; ++x) {
        positions.insert(positions.end(), {x / 59.0F, 0, y / 59.0F});
        const std::uint32_t i = y * kSide + x;
        if (x + 1 == kSide || y + 1 == kSide) continue;
        faces.insert(faces.end(), {i, i + kSide, i + 1, i + 1, i + kSide, i + kSide + 1});
      }
    }
    eigencast::Stream stream(url, {.rank = 100, .max_rate_hz = 20});

    // Your simulation: new positions at each step, in the same order. The first pose bakes; faces may change later.
    const auto start = std::chrono::steady_clock::now();
    for (int frame = 0; frame < seconds * 20; ++frame) {
      for (std::size_t i = 0; i < positions.size(); i += 3)
        positions[i + 1] = 0.1F * std::sin(6 * positions[i] + 0.15F * frame) * std::cos(4 * positions[i + 2]);
      if (stream.send(positions, faces) != EC_OK && frame % 20 == 0) std::puts(stream.stats().detail);
      std::this_thread::sleep_until(start + std::chrono::milliseconds(50) * (frame + 1));
    }
    const auto stats = stream.stats();
    std::printf("sent %llu poses, %llu bytes\n", static_cast<unsigned long long>(stats.poses_sent),
                static_cast<unsigned long long>(stats.bytes_sent));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "publish: %s\n", error.what());
    return 1;
  }
}
