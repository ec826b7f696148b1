// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "common/asset/tiles/number_coder.h"
#include "common/asset/tiles/octahedral.h"
#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

enum : std::size_t { kSplatU, kSplatV, kRadius, kParentRadius, kFrame, kSplatKinds };

constexpr std::uint8_t kNoRadius = 255;
constexpr double kStepsPerOctave = 16;
constexpr float kMaxOctahedral = 127;

/// Rounded up, so that what a disc covered stays covered.
std::uint8_t code_from_radius(double radius, double diagonal) {
  if (!(radius > 0) || !(diagonal > 0)) return kNoRadius;
  return static_cast<std::uint8_t>(
      std::clamp(std::floor(kStepsPerOctave * std::log2(diagonal / radius)), 0.0, kNoRadius - 1.0));
}
float radius_from_code(std::uint8_t code, double diagonal) {
  return code == kNoRadius ? 0 : static_cast<float>(diagonal * std::exp2(-code / kStepsPerOctave));
}

Error corrupt_splats(std::string what) {
  return fail(ErrorCode::kCorrupt, "splat tile: " + std::move(what));
}

}  // namespace

Bytes encode_splats(const Asset::Splats& splats, std::uint32_t first_row, std::uint32_t end_row,
                    std::uint32_t base_count, double diagonal) {
  Bytes coded;
  NumberWriter out(coded, kSplatKinds);
  std::int32_t radius = 0, parent_radius = 0;
  for (std::uint32_t i = first_row; i < end_row; ++i) {
    const auto octahedral = octahedral_from_normal(splats.normal[i], kMaxOctahedral);
    out.pass_signed(kSplatU, octahedral[0]);
    out.pass_signed(kSplatV, octahedral[1]);
    const std::int32_t own = code_from_radius(splats.radius[i], diagonal);
    const std::int32_t parents = i < base_count ? kNoRadius : code_from_radius(splats.parent_radius[i], diagonal);
    out.pass_signed(kRadius, own - std::exchange(radius, own));
    out.pass_signed(kParentRadius, parents - std::exchange(parent_radius, parents));
    for (const std::uint32_t corner : splats.frame[i]) {
      out.pass_signed(kFrame, static_cast<std::int32_t>(i) - static_cast<std::int32_t>(corner));
    }
  }
  out.coder().finish();
  return coded;
}

Result<void> decode_splats(ByteView coded, std::uint32_t end_row, std::uint32_t base_count, double diagonal,
                           Asset::Splats& splats) {
  const auto first_row = static_cast<std::uint32_t>(splats.size());
  Asset::Splats added;
  NumberReader in(coded, kSplatKinds);
  std::uint8_t radius = 0, parent_radius = 0;
  for (std::uint32_t i = first_row; i < end_row; ++i) {
    const auto u = static_cast<std::int8_t>(in.pass_signed(kSplatU)),
               v = static_cast<std::int8_t>(in.pass_signed(kSplatV));
    added.normal.push_back(normal_from_octahedral(u, v, kMaxOctahedral));
    radius = static_cast<std::uint8_t>(radius + in.pass_signed(kRadius));
    parent_radius = static_cast<std::uint8_t>(parent_radius + in.pass_signed(kParentRadius));
    added.radius.push_back(radius_from_code(radius, diagonal));
    added.parent_radius.push_back(radius_from_code(parent_radius, diagonal));
    std::array<std::uint32_t, 2> frame{};
    for (std::uint32_t& corner : frame) {
      const std::int64_t row = std::int64_t{i} - in.pass_signed(kFrame);
      if (row < 0 || row >= std::max<std::int64_t>(base_count, std::int64_t{i} + 1)) {
        return corrupt_splats("row " + std::to_string(i) + " has a frame from a row that is not there");
      }
      corner = static_cast<std::uint32_t>(row);
    }
    added.frame.push_back(frame);
  }
  if (!in.coder().finished()) return corrupt_splats("its bytes do not fit its rows");
  splats.append(added);
  return {};
}

}  // namespace eigencast
