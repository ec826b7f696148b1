// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "common/reconstruction/reconstruct.h"

namespace eigencast {

/// What numbers_from_coefficients() takes of each row of Psi D.
enum class NumberOf { kFirst, kLength };

/// A number for each of the first values.size() vertices, such as colours show.
///   D     r x 3
///   room  grows to three floats a vertex
/// REQUIRES: values.size() <= reconstructor.tiles().rows(), D.size() / 3 <= tiles().rank().
void numbers_from_coefficients(const Reconstructor& reconstructor, std::span<const double> D, NumberOf what,
                               std::vector<float>& room, std::span<float> values);

/// Of the finite values without the outermost hundredths: a few outliers would leave one colour for all others.
/// Nothing: there are none.
std::optional<std::array<float, 2>> range_without_outliers(std::span<const float> values);

}  // namespace eigencast
