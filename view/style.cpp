// SPDX-License-Identifier: MIT
#include "view/style.h"

#include <cmath>
#include <span>

namespace eigencast {
namespace {

// 0xRRGGBB, evenly spaced.
constexpr std::array<std::uint32_t, 11> kViridis{0x440154, 0x482576, 0x414487, 0x35608D, 0x2A788E, 0x21908C,
                                                 0x22A884, 0x43BF71, 0x7AD151, 0xBBDF27, 0xFDE725};
constexpr std::array<std::uint32_t, 17> kCividis{0x00204D, 0x002B68, 0x0F366E, 0x29416C, 0x404D6A, 0x53586B,
                                                 0x61646F, 0x6F7073, 0x7D7C77, 0x8B8778, 0x9B9477, 0xACA174,
                                                 0xBDAF6E, 0xCEBD67, 0xE0CB5C, 0xF3DB4F, 0xFFEA46};
constexpr std::array<std::uint32_t, 9> kCoolwarm{0x3B4CC0, 0x5876E2, 0x7B9FF9, 0x9EBEFF, 0xDDDDDD,
                                                 0xF5C4AC, 0xF49A7B, 0xDE614D, 0xB40426};
constexpr std::array<std::uint32_t, 17> kTurbo{0x30123B, 0x453F9D, 0x486BE6, 0x3795FF, 0x25BBED, 0x23DBC0,
                                               0x39F28D, 0x65FE61, 0x9CFC45, 0xCDED38, 0xF2D032, 0xFFAA2D,
                                               0xFA7E23, 0xE65314, 0xCE2E03, 0xAF1400, 0x7A0403};
constexpr std::array<std::uint32_t, 2> kGrey{0x1A1A1A, 0xF2F2F2};

constexpr std::array<std::span<const std::uint32_t>, kColourMaps> kColours{kViridis, kCividis, kCoolwarm, kTurbo,
                                                                           kGrey};

}  // namespace

ColourTable table_of(ColourMap map) {
  const std::span<const std::uint32_t> colours = kColours[static_cast<std::size_t>(map)];
  ColourTable table;
  for (std::size_t i = 0; i < table.size(); ++i) {
    const double at = static_cast<double>(i) / 255 * static_cast<double>(colours.size() - 1);
    const std::size_t k = std::min(static_cast<std::size_t>(at), colours.size() - 2);
    const double u = at - static_cast<double>(k);
    for (std::size_t channel = 0; channel < 3; ++channel) {
      const auto part = [&](std::size_t j) { return static_cast<double>(colours[j] >> (16 - 8 * channel) & 0xFF); };
      table[i][channel] = static_cast<std::uint8_t>(std::lround((1 - u) * part(k) + u * part(k + 1)));
    }
  }
  return table;
}

}  // namespace eigencast
