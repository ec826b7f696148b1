// SPDX-License-Identifier: MIT
#include <cassert>

#include "common/asset/tiles/number_coder.h"
#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

using Colour = std::array<std::uint8_t, 3>;

/// Grey and what is not: neighbours differ mostly in the first.
Colour parted(const Colour& rgb) {
  return {rgb[1], static_cast<std::uint8_t>(rgb[0] - rgb[1]), static_cast<std::uint8_t>(rgb[2] - rgb[1])};
}
Colour joined(const Colour& parts) {
  return {static_cast<std::uint8_t>(parts[1] + parts[0]), parts[0], static_cast<std::uint8_t>(parts[2] + parts[0])};
}

/// The colour that predicts `row`; null for the first.
const Colour* predicting_colour(std::uint32_t row, std::uint32_t parent, std::span<const Colour> earlier,
                                std::span<const Colour> here, std::uint32_t first_row) {
  const std::uint32_t from = parent < row ? parent : row - 1;
  if (row == 0) return nullptr;
  return from < first_row ? &earlier[from] : &here[from - first_row];
}

}  // namespace

Bytes encode_colours(std::span<const Colour> colours, std::uint32_t first_row, std::span<const std::uint32_t> map) {
  const std::size_t rows = map.size();
  assert(colours.size() >= first_row + rows);
  Bytes coded;
  NumberWriter out(coded, 3);
  for (std::size_t k = 0; k < rows; ++k) {
    const auto row = static_cast<std::uint32_t>(first_row + k);
    const Colour own = parted(colours[row]);
    const Colour* other = predicting_colour(row, map[k], colours, {}, row);
    const Colour known = other != nullptr ? parted(*other) : Colour{};
    for (std::size_t c = 0; c < 3; ++c) out.pass_signed(c, static_cast<std::int8_t>(own[c] - known[c]));
  }
  out.coder().finish();
  return coded;
}

Result<std::vector<Colour>> decode_colours(ByteView coded, std::span<const Colour> earlier,
                                           std::span<const std::uint32_t> map) {
  const std::size_t rows = map.size();
  const auto first_row = static_cast<std::uint32_t>(earlier.size());
  NumberReader in(coded, 3);
  std::vector<Colour> colours;
  colours.reserve(rows);
  for (std::size_t k = 0; k < rows; ++k) {
    const Colour* other =
        predicting_colour(static_cast<std::uint32_t>(first_row + k), map[k], earlier, colours, first_row);
    Colour parts = other != nullptr ? parted(*other) : Colour{};
    for (std::size_t c = 0; c < 3; ++c) parts[c] = static_cast<std::uint8_t>(parts[c] + in.pass_signed(c));
    colours.push_back(joined(parts));
  }
  if (!in.coder().finished()) return fail(ErrorCode::kCorrupt, "colour tile: its bytes do not fit its rows");
  return colours;
}

}  // namespace eigencast
