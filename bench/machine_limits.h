// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>

namespace eigencast::bench {

// What this processor can do at best, and Eigen's products as its authors would have them: the source is compiled for
// the machine it is built on (-march=native -O3), the library is not.

/// Reads every byte once: the sum of the 64-bit words, so that nothing can be left out.
std::uint64_t read_words(const void* data, std::size_t bytes);
/// Multiplies and adds float vectors that stay in registers; `rounds` times multiply_add_size() multiplications.
float multiply_add(std::size_t rounds);
std::size_t multiply_add_size();
/// The same with integers of 16 bits, two products to a word, as the kernels have it.
std::int32_t multiply_add_halves(std::size_t rounds);
std::size_t multiply_add_halves_size();

/// X = Psi C: Psi rows x rank, C rank x 3, X rows x 3, all row-major.
void eigen_product(const float* Psi, std::size_t rows, std::size_t rank, const float* C, float* X);
/// S = Psi^T Y: S rank x 3, Y rows x 3.
void eigen_transposed_product(const float* Psi, std::size_t rows, std::size_t rank, const float* Y, float* S);

}  // namespace eigencast::bench
