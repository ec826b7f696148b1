// SPDX-License-Identifier: MIT
#pragma once

#include <string_view>

/// Private to common/surface.
namespace eigencast {

/// Whether `a` comes before `b` where runs of digits compare as numbers: f2 before f10. A strict total order: names
/// equal but for leading zeros compare as bytes.
bool natural_less(std::string_view a, std::string_view b);

}  // namespace eigencast
