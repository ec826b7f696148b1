// SPDX-License-Identifier: MIT
//
// The widest vectors of the instruction set that a source file is compiled for, for kernels that exist once for each
// set (eigencast_kernel_variants in cmake/). Nothing of the standard library may be called here or in them: an inline
// function compiled with those flags could end up serving the whole program.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__ARM_NEON)
#include <arm_neon.h>
#elif defined(__wasm_simd128__)
#include <wasm_simd128.h>
#endif

// Running sums stay in registers only if the short loops over them are unrolled.
#if defined(__clang__)
#define EIGENCAST_UNROLL _Pragma("unroll")
#else
#define EIGENCAST_UNROLL _Pragma("GCC unroll 16")
#endif

namespace eigencast {
namespace {

#if defined(__AVX512F__)
constexpr std::size_t kVectorBytes = 64, kVectorRegisters = 32;
#elif defined(__AVX2__)
constexpr std::size_t kVectorBytes = 32, kVectorRegisters = 16;
#elif defined(__ARM_NEON)
constexpr std::size_t kVectorBytes = 16, kVectorRegisters = 32;
#else
constexpr std::size_t kVectorBytes = 16, kVectorRegisters = 16;
#endif
constexpr std::size_t kFloatLanes = kVectorBytes / sizeof(float);
constexpr std::size_t kDoubleLanes = kVectorBytes / sizeof(double);

typedef float Floats __attribute__((vector_size(kVectorBytes)));
typedef double Doubles __attribute__((vector_size(kVectorBytes)));
typedef std::int32_t Words __attribute__((vector_size(kVectorBytes)));

/// What lies at `from`, wherever it begins: a vector or a struct of vectors.
template <typename Vector, typename Value>
inline Vector load(const Value* from) {
  Vector to;
  std::memcpy(&to, from, sizeof to);
  return to;
}
template <typename Vector, typename Value>
inline void store(const Vector& from, Value* to) {
  std::memcpy(to, &from, sizeof from);
}

/// Has a vector stay in its register from here on: compilers else read it again from memory for each of its uses, where
/// a processor that can read one wide vector a cycle could as well multiply.
template <typename Vector>
[[gnu::always_inline]] inline void hold([[maybe_unused]] Vector& vector) {
#if defined(__AVX512F__)
  asm("" : "+v"(vector));
#elif defined(__x86_64__)
  asm("" : "+x"(vector));
#elif defined(__ARM_NEON)
  asm("" : "+w"(vector));
#endif
}

inline Floats floats_of(const Words& from) {
#if defined(__AVX512F__)
  return _mm512_maskz_cvtepi32_ps(0xffff, reinterpret_cast<__m512i>(from));
#else
  return __builtin_convertvector(from, Floats);
#endif
}

/// sums + a0 b0 + a1 b1, where a0 and a1 are the low and the high 16 bits of a word of `a`, with their signs. Wraps
/// around where that is beyond a word.
inline Words add_products_of_halves(const Words& sums, const Words& a, const Words& b) {
#if defined(__AVX512VNNI__)
  return reinterpret_cast<Words>(
      _mm512_dpwssd_epi32(reinterpret_cast<__m512i>(sums), reinterpret_cast<__m512i>(a), reinterpret_cast<__m512i>(b)));
#elif defined(__AVX512BW__)
  return sums + reinterpret_cast<Words>(_mm512_madd_epi16(reinterpret_cast<__m512i>(a), reinterpret_cast<__m512i>(b)));
#elif defined(__AVX2__)
  return sums + reinterpret_cast<Words>(_mm256_madd_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
#elif defined(__SSE2__)
  return sums + reinterpret_cast<Words>(_mm_madd_epi16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
#elif defined(__ARM_NEON)
  const int32x4_t low = vmlal_s16(sums, vmovn_s32(a), vmovn_s32(b));
  return vmlal_s16(low, vshrn_n_s32(a, 16), vshrn_n_s32(b, 16));
#elif defined(__wasm_simd128__)
  return sums + reinterpret_cast<Words>(wasm_i32x4_dot_i16x8(reinterpret_cast<v128_t>(a), reinterpret_cast<v128_t>(b)));
#else
  return sums + ((a << 16) >> 16) * ((b << 16) >> 16) + (a >> 16) * (b >> 16);
#endif
}

template <typename Lanes>
inline auto sum_of_lanes(Lanes lanes) {
  EIGENCAST_UNROLL
  for (std::size_t width = sizeof(Lanes) / sizeof(lanes[0]) / 2; width > 0; width /= 2) {
    EIGENCAST_UNROLL
    for (std::size_t i = 0; i < width; ++i) lanes[i] += lanes[i + width];
  }
  return lanes[0];
}

}  // namespace
}  // namespace eigencast
