// SPDX-License-Identifier: MIT
#include <algorithm>
#include <atomic>
#include <cassert>
#include <cmath>
#include <string>
#include <tuple>
#include <vector>

#include "common/asset/asset_limits.h"
#include "common/asset/detail.h"
#include "common/asset/tiles/octahedral.h"
#include "common/asset/tiles/tiles.h"
#include "common/core/worker_team.h"

namespace eigencast {
namespace {

constexpr float kMaxInteger = 32767;
constexpr std::size_t kRowsAtOnce = 1024;

Error corrupt_detail(const std::string& what) {
  return fail(ErrorCode::kCorrupt, "detail tile: " + what);
}

/// Planes of the low and the high bytes of 16-bit numbers.
struct Planes {
  std::uint8_t* low;
  std::uint8_t* high;
  void put(std::size_t at, std::uint16_t code) const {
    low[at] = static_cast<std::uint8_t>(code);
    high[at] = static_cast<std::uint8_t>(code >> 8);
  }
};
struct ConstPlanes {
  const std::uint8_t* low;
  const std::uint8_t* high;
  std::uint16_t get(std::size_t at) const { return static_cast<std::uint16_t>(low[at] | high[at] << 8); }
};

std::size_t predicting_row(std::size_t row, std::uint32_t parent) {
  return parent < row ? parent : row - 1;
}

/// Entries of rows [first_row, ...) as differences from those of the rows that predict them, column after column.
void put_columns(const std::vector<std::int16_t>& entries, std::size_t rank, std::size_t first_row,
                 std::span<const std::uint32_t> map, const Planes& planes) {
  const std::size_t rows = map.size();
  for_each_shared(rows, kRowsAtOnce, [&](std::size_t k) {
    const std::size_t row = first_row + k;
    const std::int16_t* own = &entries[row * rank];
    const std::int16_t* known = row == 0 ? nullptr : &entries[predicting_row(row, map[k]) * rank];
    for (std::size_t c = 0; c < rank; ++c) {
      const int difference = own[c] - (known != nullptr ? known[c] : 0);
      planes.put(c * rows + k, zigzag16(static_cast<std::uint16_t>(difference)));
    }
  });
}

/// Fills the last map.size() rows of `entries`; false where one is out of its range.
bool get_columns(const ConstPlanes& planes, std::span<const float> steps, std::span<const std::uint32_t> map,
                 std::vector<std::int16_t>& entries) {
  const std::size_t rank = steps.size(), rows = map.size(), first_row = entries.size() / rank - rows;
  constexpr std::size_t kColumns = 16;  // a cache line of a row holds twice as many
  std::atomic<bool> sound = true;
  for_shares(rank, kColumns, [&](std::size_t first, std::size_t end) {
    for (std::size_t k = 0; k < rows; ++k) {
      const std::size_t row = first_row + k;
      std::int16_t* own = &entries[row * rank];
      const std::int16_t* known = row == 0 ? nullptr : &entries[predicting_row(row, map[k]) * rank];
      for (std::size_t c = first; c < end; ++c) {
        const std::uint16_t residual = unzigzag16(planes.get(c * rows + k));
        own[c] = static_cast<std::int16_t>((known != nullptr ? known[c] : 0) + residual);
        if (own[c] == -32768 || (steps[c] == 0 && own[c] != 0)) sound = false;
      }
    }
  });
  return sound;
}

std::size_t head_bytes(std::uint32_t first_row, std::size_t rank) {
  return first_row == 0 ? 1 + 4 + 4 * rank : 0;
}

float largest_offset(const Asset::Detail& detail) {
  float largest = 0;
  for (const auto& offset : detail.offset) {
    for (const float component : offset) largest = std::max(largest, std::abs(component));
  }
  return largest;
}

}  // namespace

std::uint64_t detail_bytes(std::uint64_t rows, std::uint32_t first_row, std::uint32_t rank, std::uint32_t axes) {
  return head_bytes(first_row, rank) + rows * 2 * (2 + axes + 2 * std::uint64_t{rank});
}

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
  const std::size_t rows = map.size(), rank = detail.steps.size();
  const float unit = std::max(largest_offset(detail) / kMaxInteger, asset_limits::kMinColumnScale);
  Bytes raw;
  if (first_row == 0) {
    ByteWriter out(raw);
    out.u8(static_cast<std::uint8_t>(detail.axes));
    out.f32(unit);
    for (const float step : detail.steps) out.f32(step);
  }
  std::size_t at = raw.size();
  raw.resize(detail_bytes(rows, first_row, static_cast<std::uint32_t>(rank), detail.axes));
  const auto next = [&](std::size_t columns) {
    const Planes planes{&raw[at], &raw[at] + columns * rows};
    at += 2 * columns * rows;
    return planes;
  };
  const Planes normals = next(2), offsets = next(detail.axes);
  for (std::size_t k = 0; k < rows; ++k) {
    const auto octahedral = octahedral_from_normal(detail.normal[first_row + k], kMaxInteger);
    for (std::size_t c = 0; c < 2; ++c) normals.put(c * rows + k, zigzag16(static_cast<std::uint16_t>(octahedral[c])));
    for (std::size_t c = 0; c < detail.axes; ++c) {
      const float value = detail.offset[first_row + k][detail.axes == 1 ? 2 : c] / unit;
      const auto integer = static_cast<std::int16_t>(std::lrint(std::clamp(value, -kMaxInteger, kMaxInteger)));
      offsets.put(c * rows + k, zigzag16(static_cast<std::uint16_t>(integer)));
    }
  }
  put_columns(detail.along_x, rank, first_row, map, next(rank));
  put_columns(detail.along_y, rank, first_row, map, next(rank));
  assert(at == raw.size());
  return raw;
}

Result<void> decode_detail(ByteView raw, std::uint32_t rank, std::span<const std::uint32_t> map,
                           Asset::Detail& detail) {
  const std::size_t rows = map.size(), before = detail.size();
  const auto first_row = static_cast<std::uint32_t>(before);
  Asset::Detail head;
  ByteReader in(raw);
  if (first_row == 0) {
    head.axes = in.u8();
    head.unit = in.f32();
    for (std::uint32_t k = 0; k < rank && !in.failed(); ++k) head.steps.push_back(in.f32());
    if (in.failed() || (head.axes != 1 && head.axes != 3) || !asset_limits::is_column_scale(head.unit) ||
        !std::all_of(head.steps.begin(), head.steps.end(), asset_limits::is_column_scale))
      return corrupt_detail("its axes or steps are out of range");
  }
  const Asset::Detail& known = first_row == 0 ? head : detail;
  if (raw.size() != detail_bytes(rows, first_row, rank, known.axes)) return corrupt_detail("it does not fit its rows");
  const std::uint8_t* at = raw.data() + in.position();
  const auto next = [&](std::size_t columns) {
    const ConstPlanes planes{at, at + columns * rows};
    at += 2 * columns * rows;
    return planes;
  };
  const ConstPlanes normals = next(2), offsets = next(known.axes);
  bool sound = true;
  for (std::vector<std::int16_t>* along : {&detail.along_x, &detail.along_y}) {
    along->reserve((before + rows) * rank);
    along->resize((before + rows) * rank);
    sound &= get_columns(next(rank), known.steps, map, *along);
  }
  if (!sound) {
    for (std::vector<std::int16_t>* along : {&detail.along_x, &detail.along_y}) along->resize(before * rank);
    return corrupt_detail("a derivative is out of its range");
  }
  const auto signed_at = [&](const ConstPlanes& planes, std::size_t entry) {
    return static_cast<std::int16_t>(unzigzag16(planes.get(entry)));
  };
  for (std::size_t k = 0; k < rows; ++k) {
    detail.normal.push_back(normal_from_octahedral(signed_at(normals, k), signed_at(normals, rows + k), kMaxInteger));
    auto& offset = detail.offset.emplace_back();
    for (std::size_t c = 0; c < known.axes; ++c)
      offset[known.axes == 1 ? 2 : c] = static_cast<float>(signed_at(offsets, c * rows + k)) * known.unit;
  }
  if (first_row == 0) std::tie(detail.axes, detail.unit, detail.steps) = std::tie(head.axes, head.unit, head.steps);
  return {};
}

}  // namespace eigencast
