// SPDX-License-Identifier: MIT
//
// reconstruction_levels CLIP SET THREADS SECONDS: a line of CSV for each tenth of the vertices: milliseconds that one
// pose's positions take at that level of detail, the clip baked as for streaming (r = 200), one frame after the other:
// the mean over SECONDS, in which a quota shows, and the median. SET is baseline or best; THREADS 0 is as many as pay.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "common/reconstruction/reconstruct.h"
#include "sdk/asset_cache.h"
#include "sender/clip_coefficients.h"
#include "sender/source.h"

int main(int argc, char** argv) {
  using namespace eigencast;
  using Clock = std::chrono::steady_clock;
  if (argc != 5) return std::fprintf(stderr, "reconstruction_levels CLIP baseline|best THREADS SECONDS\n"), 2;
  const InstructionSet set =
      std::strcmp(argv[2], "baseline") == 0 ? InstructionSet::kBaseline : instruction_sets().back();
  const std::chrono::duration<double> wanted(std::strtod(argv[4], nullptr));
  SourceOptions options;
  options.input = argv[1];
  options.cache_dir = default_cache_dir();
  const auto source = bake_source(options, {});
  if (!source) return std::fprintf(stderr, "%s\n", source.error().message.c_str()), 1;
  const Asset& asset = source->baked.asset;
  const std::uint32_t n = asset.vertex_count;
  const auto projector = Projector::create(asset);
  if (!projector) return std::fprintf(stderr, "%s\n", projector.error().message.c_str()), 1;
  const auto frames = ClipCoefficients::create(*source->clip, *projector, {});
  if (!frames) return std::fprintf(stderr, "%s\n", frames.error().message.c_str()), 1;
  std::vector<float> positions(std::size_t{n} * 3);
  Reconstructor reconstructor(set, static_cast<unsigned>(std::strtoul(argv[3], nullptr, 10)));
  reconstructor.update(asset);
  std::puts("vertices,set,level_percent,mean_ms,median_ms");
  for (std::uint32_t level = 10; level <= 100; level += 10) {
    const std::uint32_t N = n / 100 * level;
    std::vector<double> ms;
    for (const auto begin = Clock::now(); Clock::now() - begin < wanted;) {
      const auto C = frames->at(ms.size() % source->clip->frame_count());
      const auto before = Clock::now();
      reconstructor.rebuild(*C, 3, asset.rank, N, positions);
      ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - before).count());
    }
    double sum = 0;
    for (const double value : ms) sum += value;
    std::sort(ms.begin(), ms.end());
    std::printf("%u,%s,%u,%.4f,%.4f\n", n, name_of(set), level, sum / static_cast<double>(ms.size()),
                ms[ms.size() / 2]);
  }
}
