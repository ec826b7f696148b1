// SPDX-License-Identifier: MIT
//
// SHA-256 after FIPS 180-4, in place of OpenSSL's: browsers have crypto.subtle in secure contexts only.
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>

#include "common/core/hash/sha256.h"

namespace eigencast {
namespace {

constexpr std::size_t kBlock = 64;

constexpr std::array<std::uint32_t, 64> kRounds{
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

struct State {
  std::array<std::uint32_t, 8> sums{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                    0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
  std::array<std::uint8_t, kBlock> rest{};
  std::size_t rest_bytes = 0;
  std::uint64_t bytes = 0;

  void add_block(const std::uint8_t* block) {
    std::array<std::uint32_t, 64> w;
    for (std::size_t i = 0; i < 16; ++i) {
      const std::uint8_t* b = block + 4 * i;
      w[i] = std::uint32_t{b[0]} << 24 | std::uint32_t{b[1]} << 16 | std::uint32_t{b[2]} << 8 | b[3];
    }
    for (std::size_t i = 16; i < 64; ++i) {
      const std::uint32_t a = w[i - 15], b = w[i - 2];
      w[i] = w[i - 16] + (std::rotr(a, 7) ^ std::rotr(a, 18) ^ a >> 3) + w[i - 7] +
             (std::rotr(b, 17) ^ std::rotr(b, 19) ^ b >> 10);
    }
    auto [a, b, c, d, e, f, g, h] = sums;
    for (std::size_t i = 0; i < 64; ++i) {
      const std::uint32_t one =
          h + (std::rotr(e, 6) ^ std::rotr(e, 11) ^ std::rotr(e, 25)) + ((e & f) ^ (~e & g)) + kRounds[i] + w[i];
      const std::uint32_t two = (std::rotr(a, 2) ^ std::rotr(a, 13) ^ std::rotr(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
      h = g;
      g = f;
      f = e;
      e = d + one;
      d = c;
      c = b;
      b = a;
      a = one + two;
    }
    const std::array<std::uint32_t, 8> more{a, b, c, d, e, f, g, h};
    for (std::size_t i = 0; i < sums.size(); ++i) sums[i] += more[i];
  }

  void add(ByteView data) {
    bytes += data.size();
    while (!data.empty()) {
      if (rest_bytes == 0 && data.size() >= kBlock) {
        add_block(data.data());
        data = data.subspan(kBlock);
        continue;
      }
      const std::size_t count = std::min(kBlock - rest_bytes, data.size());
      std::copy_n(data.begin(), count, rest.begin() + static_cast<std::ptrdiff_t>(rest_bytes));
      rest_bytes = (rest_bytes + count) % kBlock;
      data = data.subspan(count);
      if (rest_bytes == 0) add_block(rest.data());
    }
  }
};

State& state_from(void* state) {
  return *static_cast<State*>(state);
}

}  // namespace

Sha256Stream::Sha256Stream() : context_(new State, [](void* state) { delete static_cast<State*>(state); }) {}

void Sha256Stream::update(ByteView data) {
  state_from(context_.get()).add(data);
}

Sha256 Sha256Stream::finish() {
  State& state = state_from(context_.get());
  const std::uint64_t bits = 8 * state.bytes;
  std::array<std::uint8_t, kBlock + 8> end{0x80};
  const std::size_t zeros = (kBlock + 55 - state.rest_bytes) % kBlock + 1;  // The 0x80 among them.
  for (std::size_t i = 0; i < 8; ++i) end[zeros + i] = static_cast<std::uint8_t>(bits >> (56 - 8 * i));
  state.add(ByteView(end.data(), zeros + 8));
  Sha256 result;
  for (std::size_t i = 0; i < 32; ++i)
    result.digest[i] = static_cast<std::uint8_t>(state.sums[i / 4] >> (24 - 8 * (i % 4)));
  return result;
}

}  // namespace eigencast
