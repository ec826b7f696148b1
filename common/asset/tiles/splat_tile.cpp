// SPDX-License-Identifier: MIT
#include <algorithm>
#include <cmath>
#include <string>

#include "common/asset/tiles/octahedral.h"
#include "common/asset/tiles/tiles.h"

namespace eigencast {
namespace {

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

// By row: 4 bytes and 2 varints.
std::uint64_t min_splat_bytes(std::uint64_t rows) {
  return rows * (4 + 2);
}

std::uint64_t max_splat_bytes(std::uint64_t rows) {
  return rows * (4 + 2 * 5);
}

Bytes encode_splats(const Asset::Splats& splats, std::uint32_t first_row, std::uint32_t end_row,
                    std::uint32_t base_count, double diagonal) {
  const std::size_t rows = end_row - first_row;
  Bytes raw(4 * rows);
  for (std::size_t k = 0; k < rows; ++k) {
    const std::size_t i = first_row + k;
    const auto octahedral = octahedral_from_normal(splats.normal[i], kMaxOctahedral);
    raw[k] = static_cast<std::uint8_t>(octahedral[0]);
    raw[rows + k] = static_cast<std::uint8_t>(octahedral[1]);
    raw[2 * rows + k] = code_from_radius(splats.radius[i], diagonal);
    raw[3 * rows + k] = i < base_count ? kNoRadius : code_from_radius(splats.parent_radius[i], diagonal);
  }
  ByteWriter out(raw);
  for (std::uint32_t i = first_row; i < end_row; ++i) {
    for (const std::uint32_t corner : splats.frame[i]) out.varint(zigzag(std::int64_t{i} - corner));
  }
  return raw;
}

Result<void> decode_splats(ByteView raw, std::uint32_t end_row, std::uint32_t base_count, double diagonal,
                           Asset::Splats& splats) {
  const auto first_row = static_cast<std::uint32_t>(splats.size());
  const std::size_t rows = end_row - first_row;
  if (raw.size() < 4 * rows) return corrupt_splats("ends too early");
  Asset::Splats added;
  ByteReader in(raw.subspan(4 * rows));
  for (std::uint32_t i = first_row; i < end_row; ++i) {
    const std::size_t k = i - first_row;
    added.normal.push_back(normal_from_octahedral(static_cast<std::int8_t>(raw[k]),
                                                  static_cast<std::int8_t>(raw[rows + k]), kMaxOctahedral));
    added.radius.push_back(radius_from_code(raw[2 * rows + k], diagonal));
    added.parent_radius.push_back(radius_from_code(raw[3 * rows + k], diagonal));
    std::array<std::uint32_t, 2> frame{};
    for (std::uint32_t& corner : frame) {
      const std::uint64_t code = in.varint();
      const std::int64_t row = code > (std::uint64_t{1} << 33) ? -1 : i - unzigzag(code);
      if (row < 0 || row >= std::max<std::int64_t>(base_count, std::int64_t{i} + 1)) {
        return corrupt_splats("row " + std::to_string(i) + " has a frame from a row that is not there");
      }
      corner = static_cast<std::uint32_t>(row);
    }
    added.frame.push_back(frame);
  }
  if (!in.finished()) return corrupt_splats("its bytes do not fit its rows");
  splats.append(added);
  return {};
}

}  // namespace eigencast
