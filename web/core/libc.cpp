// SPDX-License-Identifier: MIT
//
// In place of libc's: its tables are larger than all that the core asks of them, and it copies without the instructions
// that browsers have.
#include <cmath>
#include <cstddef>
#include <cstdint>

extern "C" {

void* memcpy(void* to, const void* from, std::size_t bytes) {
  return __builtin_memcpy(to, from, bytes);
}
void* memmove(void* to, const void* from, std::size_t bytes) {
  return __builtin_memmove(to, from, bytes);
}
void* memset(void* to, int value, std::size_t bytes) {
  return __builtin_memset(to, value, bytes);
}

/// REQUIRES: a whole exponent from 0 on (damped_steps() of common/motion).
double pow(double base, double exponent) {
  double result = 1;
  for (auto left = static_cast<std::uint32_t>(exponent); left != 0; left >>= 1, base *= base)
    if ((left & 1) != 0) result *= base;
  return result;
}

/// Within 1e-15 (radii of discs, common/asset/tiles/splat_tile).
double exp2(double x) {
  constexpr double kLn2 = 0.693147180559945309417232121458176568;
  const double whole = std::floor(x), part = (x - whole) * kLn2;
  double sum = 1;
  for (int i = 19; i > 0; --i) sum = 1 + sum * part / i;
  return std::scalbn(sum, static_cast<int>(whole));
}

}  // extern "C"
