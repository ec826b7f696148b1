// SPDX-License-Identifier: MIT
//
// reconstruction_rate [VERTICES [RANK]]: times of X = Psi C and C = Psi^T M X on a basis of random entries (default
// 42,321 x 200, the elephant's), beside a plain read of the same bytes, the multiplications that the processor can do,
// and Eigen's products. All in one run, one after the other in every repetition; medians.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <string>
#include <vector>

#include "bench/machine_limits.h"
#include "bench/random_asset.h"
#include "common/core/worker_team.h"
#include "common/reconstruction/reconstruct.h"

namespace {

using namespace eigencast;

constexpr int kRepetitions = 41;

struct Case {
  std::string name;
  std::function<void()> run;
  std::vector<double> seconds = {};
  double median() const {
    std::vector<double> sorted = seconds;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
    return sorted[sorted.size() / 2];
  }
};

/// One repetition of each case after the other, so that a drift of the machine meets all alike. Each case finds in the
/// caches what the others left there; `at_hand`: what it left itself the moment before.
void measure(std::vector<Case>& cases, bool at_hand) {
  for (Case& c : cases) c.run();
  for (int i = 0; i < kRepetitions; ++i) {
    for (Case& c : cases) {
      if (at_hand) c.run();
      const auto begin = std::chrono::steady_clock::now();
      c.run();
      c.seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    }
  }
}

volatile std::uint64_t sink;

/// `share` of the bytes of every tile row, by as many threads as the team has.
void read_all(const AlignedVector<std::uint64_t>& words, std::size_t bytes, unsigned threads) {
  if (threads == 1) {
    sink = bench::read_words(words.data(), bytes);
    return;
  }
  const std::size_t part = bytes / threads / 512 * 512;
  worker_team().run(threads, [&](std::size_t i) {
    sink = bench::read_words(reinterpret_cast<const unsigned char*>(words.data()) + i * part, part);
  });
}

/// Multiplications a second of one core: `size` in each of the rounds that `work` is asked for.
double multiplication_rate(std::size_t size, const std::function<std::uint64_t(std::size_t)>& work) {
  std::vector<double> rates;
  for (int i = 0; i < 9; ++i) {
    constexpr std::size_t kRounds = 2'000'000;
    const auto begin = std::chrono::steady_clock::now();
    sink = work(kRounds);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    rates.push_back(static_cast<double>(kRounds * size) / seconds);
  }
  std::nth_element(rates.begin(), rates.begin() + 4, rates.end());
  return rates[4];
}

/// What one core can do.
struct CoreRates {
  double floats = multiplication_rate(bench::multiply_add_size(), [](std::size_t rounds) {
    return static_cast<std::uint64_t>(bench::multiply_add(rounds));
  });
  double halves = multiplication_rate(bench::multiply_add_halves_size(), [](std::size_t rounds) {
    return static_cast<std::uint64_t>(bench::multiply_add_halves(rounds));
  });
};

struct Scene {
  const Asset& grid;
  const Asset& floats;
  std::vector<double> C;
  std::vector<float> C_float;
  std::vector<std::vector<float>> X;  // of six instances
};

void compare_products(Scene& scene, std::uint32_t N, bool at_hand, const CoreRates& core) {
  const std::uint32_t r = scene.grid.rank;
  const AlignedVector<std::uint64_t> words(std::size_t{N} * r / 2 + 64, 1);
  std::vector<Reconstructor> all;
  all.reserve(32);
  std::vector<Case> cases;
  struct Note {
    std::size_t bytes;
    std::size_t poses;
    unsigned threads;
    bool integers = false;
  };
  std::vector<Note> notes;
  const auto add = [&](std::string name, Note note, std::function<void()> run) {
    cases.push_back({std::move(name), std::move(run)});
    notes.push_back(note);
  };
  const unsigned most = worker_team().threads();
  const auto one_pose = [&](InstructionSet set, bool integers, unsigned threads, std::size_t poses) {
    Reconstructor& reconstructor = all.emplace_back(set, threads);
    reconstructor.update(integers ? scene.grid : scene.floats);
    const std::size_t bytes = std::size_t{N} * (integers ? 2 * std::size_t{r} + 8 : 4 * std::size_t{r});
    const std::string name = std::string(integers ? "int16 " : "float ") + name_of(set) + ", " + std::to_string(poses) +
                             (poses == 1 ? " pose, " : " poses, ") + (threads == 1 ? "1 thread" : "threads");
    add(name, {bytes, poses, threads == 1 ? 1 : most, integers}, [&, poses, N] {
      std::vector<PoseToRebuild> jobs;
      for (std::size_t p = 0; p < poses; ++p) jobs.push_back({scene.C, 3, scene.X[p]});
      reconstructor.rebuild(jobs, r, N);
    });
  };
  for (const std::size_t width : {std::size_t{2}, std::size_t{4}}) {
    for (const unsigned threads : {1U, most}) {
      const std::size_t bytes = std::size_t{N} * r * width;
      add("read of the same bytes, " + std::string(width == 2 ? "int16" : "float") +
              (threads == 1 ? ", 1 thread" : ", threads"),
          {bytes, 0, threads}, [&words, bytes, threads] { read_all(words, bytes, threads); });
    }
  }
  add("Eigen (-march=native), float, 1 thread", {std::size_t{N} * r * 4, 1, 1},
      [&, N] { bench::eigen_product(scene.floats.floats.data(), N, r, scene.C_float.data(), scene.X[0].data()); });
  for (const InstructionSet set : instruction_sets()) {
    for (const bool integers : {false, true}) one_pose(set, integers, 1, 1);
  }
  for (const bool integers : {false, true}) {
    one_pose(instruction_sets().back(), integers, 0, 1);
    one_pose(instruction_sets().back(), integers, 1, 6);
    one_pose(instruction_sets().back(), integers, 0, 6);
  }
  measure(cases, at_hand);
  std::printf("\nX = Psi C, %u x %u, %s\n%-42s %9s %8s %14s\n", N, r,
              at_hand ? "basis in the cache as far as it fits" : "basis out of the cache", "", "ms", "GB/s",
              "of arithmetic");
  for (std::size_t i = 0; i < cases.size(); ++i) {
    const double seconds = cases[i].median();
    const double multiplications = static_cast<double>(N) * r * 3 * static_cast<double>(notes[i].poses);
    std::printf("%-42s %9.3f %8.1f %13.0f%%\n", cases[i].name.c_str(), seconds * 1e3,
                static_cast<double>(notes[i].bytes) / seconds * 1e-9,
                100 * multiplications / ((notes[i].integers ? core.halves : core.floats) * notes[i].threads) / seconds);
  }
}

void compare_transforms(const Scene& scene) {
  const std::uint32_t n = scene.grid.vertex_count, r = scene.grid.rank;
  const std::vector<float> positions(std::size_t{n} * 3, 0.5F);
  std::vector<float> S(std::size_t{r} * 3);
  std::vector<Projector> projectors;
  projectors.reserve(8);
  std::vector<Case> cases;
  cases.push_back({"Eigen (-march=native), float, 1 thread, Psi^T Y only", [&] {
                     bench::eigen_transposed_product(scene.floats.floats.data(), n, r, positions.data(), S.data());
                   }});
  for (const bool integers : {false, true}) {
    for (const unsigned threads : {1U, 0U}) {
      auto made = Projector::create(integers ? scene.grid : scene.floats, instruction_sets().back(), threads);
      if (!made) std::exit(1);
      Projector& projector = projectors.emplace_back(std::move(*made));
      cases.push_back({std::string(integers ? "int16" : "float") + (threads == 1 ? ", 1 thread" : ", threads"), [&] {
                         if (!projector.coefficients_from_positions(positions)) std::exit(1);
                       }});
    }
  }
  measure(cases, false);
  std::printf("\nC = (Psi^T M Psi)^-1 Psi^T M X, %u x %u\n", n, r);
  for (const Case& c : cases) std::printf("%-52s %9.3f ms\n", c.name.c_str(), c.median() * 1e3);
}

}  // namespace

int main(int argc, char** argv) {
  const auto n = static_cast<std::uint32_t>(argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 42321);
  const auto r = static_cast<std::uint32_t>(argc > 2 ? std::strtoul(argv[2], nullptr, 10) : 200);
  if (n < 64 || r < 4) return std::fprintf(stderr, "reconstruction_rate: VERTICES >= 64, RANK >= 4\n"), 2;
  const Asset grid = bench::random_asset(n, r, true), floats = bench::random_asset(n, r, false);
  Scene scene{grid, floats, {}, {}, std::vector<std::vector<float>>(6, std::vector<float>(std::size_t{n} * 3))};
  scene.C = bench::random_coefficients(r);
  scene.C_float.assign(scene.C.begin(), scene.C.end());
  const CoreRates core;
  std::printf(
      "one core multiplies and adds %.1f thousand million floats, %.1f integers of 16 bits a second; %u threads; "
      "medians "
      "of %d\n",
      core.floats * 1e-9, core.halves * 1e-9, worker_team().threads(), kRepetitions);
  compare_products(scene, n, false, core);
  compare_products(scene, n / 10, false, core);
  compare_products(scene, n / 10, true, core);
  compare_transforms(scene);
}
