// SPDX-License-Identifier: MIT
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <string>
#include <tuple>
#include <type_traits>
#include <vector>

#include "common/asset/asset_limits.h"
#include "common/asset/detail.h"
#include "common/asset/tiles/number_coder.h"
#include "common/asset/tiles/octahedral.h"
#include "common/asset/tiles/tiles.h"
#include "common/core/worker_team.h"

namespace eigencast {
namespace {

enum : std::size_t { kDetailNormal = 0, kDetailOffset = 2, kDetailKinds = 5 };

constexpr float kMaxInteger = 32767;
constexpr std::size_t kRowsAtOnce = 1024;

Error corrupt_detail(const std::string& what) {
  return fail(ErrorCode::kCorrupt, "detail tile: " + what);
}

std::size_t predicting_row(std::size_t row, std::uint32_t parent) {
  return parent < row ? parent : row - 1;
}

/// Both directions: rows [first_row, first_row + map.size()) of `entries`, column after column, as differences from
/// those of the rows that predict them. False: one that was read is out of its range.
template <typename Coder, typename Entries>
bool pass_columns(Coder& coder, std::span<const float> steps, std::size_t first_row, std::span<const std::uint32_t> map,
                  Entries& entries) {
  constexpr bool kReads = !std::is_const_v<Entries>;
  const std::size_t rank = steps.size();
  ResidualModel model(map.size());
  for (std::size_t c = 0; c < rank; ++c) {
    model.next_column();
    for (std::size_t k = 0; k < map.size(); ++k) {
      const std::size_t row = first_row + k;
      const std::int32_t known = row == 0 ? 0 : entries[predicting_row(row, map[k]) * rank + c];
      const std::int32_t residual = model.pass(coder, k, kReads ? 0 : entries[row * rank + c] - known);
      if constexpr (kReads) {
        const std::int64_t value = std::int64_t{known} + residual;
        if (std::abs(value) > 32767 || (steps[c] == 0 && value != 0)) return false;
        entries[row * rank + c] = static_cast<std::int16_t>(value);
      }
    }
  }
  return true;
}

float largest_offset(const Asset::Detail& detail) {
  float largest = 0;
  for (const auto& offset : detail.offset) {
    for (const float component : offset) largest = std::max(largest, std::abs(component));
  }
  return largest;
}

}  // namespace

Asset::Detail detail_on_basis(const Asset& asset, std::span<const float> basis) {
  Asset::Detail detail = asset.detail;
  const std::size_t r = asset.rank;
  using Vector = std::array<double, 3>;
  const auto at_rest = [&](const auto& coefficient_factor) {
    Vector sum{};
    for (std::size_t k = 0; k < r; ++k) {
      const double factor = coefficient_factor(k);
      for (std::size_t d = 0; d < 3; ++d) sum[d] += factor * asset.rest[3 * k + d];
    }
    return sum;
  };
  for_each_shared(asset.vertex_count, kRowsAtOnce, [&](std::size_t i) {
    const auto derivative = [&](const std::vector<std::int16_t>& along) {
      return at_rest([&](std::size_t k) { return static_cast<double>(along[i * r + k]) * double{detail.steps[k]}; });
    };
    const auto frame = frame_from_derivatives(derivative(detail.along_x), derivative(detail.along_y));
    const Vector moved =
        frame.to_frame(at_rest([&](std::size_t k) { return double{asset.entry(i, k)} - double{basis[i * r + k]}; }));
    for (std::size_t d = detail.axes == 1 ? 2 : 0; d < 3; ++d) detail.offset[i][d] += static_cast<float>(moved[d]);
  });
  return detail;
}

Bytes encode_detail(const Asset::Detail& detail, std::uint32_t first_row, std::span<const std::uint32_t> map) {
  const float unit = std::max(largest_offset(detail) / kMaxInteger, asset_limits::kMinColumnScale);
  Bytes coded;
  ByteWriter out(coded);
  if (first_row == 0) {
    out.u8(static_cast<std::uint8_t>(detail.axes));
    out.f32(unit);
    for (const float step : detail.steps) out.f32(step);
  }
  std::array<Bytes, 2> parts;
  worker_team().run(2, [&](std::size_t part) {
    if (part == 1) {
      BitWriter coder(parts[1]);
      pass_columns(coder, detail.steps, first_row, map, detail.along_y);
      coder.finish();
      return;
    }
    NumberWriter numbers(parts[0], kDetailKinds);
    for (std::size_t k = 0; k < map.size(); ++k) {
      const auto octahedral = octahedral_from_normal(detail.normal[first_row + k], kMaxInteger);
      for (std::size_t c = 0; c < 2; ++c) numbers.pass_signed(kDetailNormal + c, octahedral[c]);
      for (std::size_t c = 0; c < detail.axes; ++c) {
        const float value = detail.offset[first_row + k][detail.axes == 1 ? 2 : c] / unit;
        numbers.pass_signed(kDetailOffset + c,
                            static_cast<std::int32_t>(std::lrint(std::clamp(value, -kMaxInteger, kMaxInteger))));
      }
    }
    pass_columns(numbers.coder(), detail.steps, first_row, map, detail.along_x);
    numbers.coder().finish();
  });
  out.u32(static_cast<std::uint32_t>(parts[0].size()));
  for (const Bytes& part : parts) out.bytes(part);
  return coded;
}

Result<void> decode_detail(ByteView coded, std::uint32_t rank, std::span<const std::uint32_t> map,
                           Asset::Detail& detail) {
  const std::size_t rows = map.size(), before = detail.size();
  Asset::Detail head;
  ByteReader in(coded);
  if (before == 0) {
    head.axes = in.u8();
    head.unit = in.f32();
    for (std::uint32_t k = 0; k < rank && !in.failed(); ++k) head.steps.push_back(in.f32());
    if (in.failed() || (head.axes != 1 && head.axes != 3) || !asset_limits::is_column_scale(head.unit) ||
        !std::all_of(head.steps.begin(), head.steps.end(), asset_limits::is_column_scale))
      return corrupt_detail("its axes or steps are out of range");
  }
  const Asset::Detail& known = before == 0 ? head : detail;
  const std::size_t first_bytes = in.u32();
  if (in.failed() || first_bytes > in.remaining()) return corrupt_detail("ends too early");
  const ByteView rest = coded.subspan(in.position());
  std::vector<std::array<float, 3>> normals, offsets;
  std::array<bool, 2> sound{};
  for (std::vector<std::int16_t>* along : {&detail.along_x, &detail.along_y}) {
    along->reserve((before + rows) * rank);
    along->resize((before + rows) * rank);
  }
  worker_team().run(2, [&](std::size_t part) {
    if (part == 1) {
      BitReader coder(rest.subspan(first_bytes));
      sound[1] = pass_columns(coder, known.steps, before, map, detail.along_y) && coder.finished();
      return;
    }
    NumberReader numbers(rest.first(first_bytes), kDetailKinds);
    bool within = true;
    const auto next = [&](std::size_t kind) {
      const std::int32_t value = numbers.pass_signed(kind);
      within &= value >= -32767 && value <= 32767;
      return static_cast<std::int16_t>(value);
    };
    for (std::size_t k = 0; k < rows && within; ++k) {
      const std::int16_t u = next(kDetailNormal), v = next(kDetailNormal + 1);
      normals.push_back(normal_from_octahedral(u, v, kMaxInteger));
      auto& offset = offsets.emplace_back();
      for (std::size_t c = 0; c < known.axes; ++c)
        offset[known.axes == 1 ? 2 : c] = static_cast<float>(next(kDetailOffset + c)) * known.unit;
    }
    sound[0] =
        within && pass_columns(numbers.coder(), known.steps, before, map, detail.along_x) && numbers.coder().finished();
  });
  if (!sound[0] || !sound[1]) {
    for (std::vector<std::int16_t>* along : {&detail.along_x, &detail.along_y}) along->resize(before * rank);
    return corrupt_detail("a number is out of its range, or its bytes do not fit its rows");
  }
  detail.normal.insert(detail.normal.end(), normals.begin(), normals.end());
  detail.offset.insert(detail.offset.end(), offsets.begin(), offsets.end());
  if (before == 0) std::tie(detail.axes, detail.unit, detail.steps) = std::tie(head.axes, head.unit, head.steps);
  return {};
}

}  // namespace eigencast
