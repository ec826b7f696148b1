// SPDX-License-Identifier: MIT
#include "bench/machine_limits.h"

#include <Eigen/Core>
#include <cstring>

#include "common/core/vector_lanes.h"

namespace eigencast::bench {
namespace {

constexpr std::size_t kChains = 12;

using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Columns3 = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

Eigen::Index index(std::size_t i) {
  return static_cast<Eigen::Index>(i);
}

}  // namespace

std::uint64_t read_words(const void* data, std::size_t bytes) {
  constexpr std::size_t kAtOnce = 64;
  const auto* at = static_cast<const unsigned char*>(data);
  std::uint64_t sums[kAtOnce] = {};
  for (std::size_t i = 0; i + kAtOnce * 8 <= bytes; i += kAtOnce * 8) {
    for (std::size_t j = 0; j < kAtOnce; ++j) {
      std::uint64_t word;
      std::memcpy(&word, at + i + 8 * j, 8);
      sums[j] += word;
    }
  }
  std::uint64_t sum = 0;
  for (const std::uint64_t value : sums) sum += value;
  return sum;
}

float multiply_add(std::size_t rounds) {
  Floats chains[kChains];
  for (std::size_t i = 0; i < kChains; ++i) chains[i] = Floats{} + static_cast<float>(i);
  Floats factor = Floats{} + 0.999F;
  Floats term = Floats{} + 0.001F;
  for (std::size_t round = 0; round < rounds; ++round) {
    asm volatile("" : "+x"(factor), "+x"(term));  // the compiler may not see through the loop
    for (std::size_t i = 0; i < kChains; ++i) chains[i] = chains[i] * factor + term;
  }
  float sum = 0;
  for (const Floats& chain : chains) sum += chain[0];
  return sum;
}
std::size_t multiply_add_size() {
  return kChains * kFloatLanes;
}

std::int32_t multiply_add_halves(std::size_t rounds) {
  Words chains[kChains];
  for (std::size_t i = 0; i < kChains; ++i) chains[i] = Words{} + static_cast<std::int32_t>(i);
  Words a = Words{} + 3, b = Words{} + 5;
  for (std::size_t round = 0; round < rounds; ++round) {
    hold(a);
    hold(b);
    for (std::size_t i = 0; i < kChains; ++i) chains[i] = add_products_of_halves(chains[i], a, b);
  }
  std::int32_t sum = 0;
  for (const Words& chain : chains) sum += chain[0];
  return sum;
}
std::size_t multiply_add_halves_size() {
  return 2 * kChains * kFloatLanes;
}

void eigen_product(const float* Psi, std::size_t rows, std::size_t rank, const float* C, float* X) {
  Eigen::Map<Columns3>(X, index(rows), 3).noalias() =
      Eigen::Map<const RowMajor>(Psi, index(rows), index(rank)) * Eigen::Map<const Columns3>(C, index(rank), 3);
}

void eigen_transposed_product(const float* Psi, std::size_t rows, std::size_t rank, const float* Y, float* S) {
  Eigen::Map<Columns3>(S, index(rank), 3).noalias() =
      Eigen::Map<const RowMajor>(Psi, index(rows), index(rank)).transpose() *
      Eigen::Map<const Columns3>(Y, index(rows), 3);
}

}  // namespace eigencast::bench
