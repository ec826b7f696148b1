// SPDX-License-Identifier: MIT
#include "common/spectral/known_motion.h"

#include <span>
#include <string>
#include <unordered_map>

namespace eigencast {
namespace {

/// The first column of each bone, and of each morph target on it, numbered on first use.
class ColumnIndex {
 public:
  explicit ColumnIndex(std::size_t targets) : keys_of_bone_(targets + 1) {}
  std::size_t of_bone(std::size_t bone) { return first_column(bone * keys_of_bone_, 4); }
  std::size_t of_target(std::size_t bone, std::size_t target) {
    return first_column(bone * keys_of_bone_ + 1 + target, 3);
  }
  std::size_t count() const { return count_; }

 private:
  std::size_t first_column(std::uint64_t key, std::size_t columns) {
    const auto [at, added] = first_.try_emplace(key, count_);
    if (added) count_ += columns;
    return at->second;
  }
  std::unordered_map<std::uint64_t, std::size_t> first_;
  std::uint64_t keys_of_bone_;
  std::size_t count_ = 0;
};

/// Calls visit(vertex, column, weight, values) for all nonzero entries.
template <typename Visit>
void for_each_entry(const Rig& rig, ColumnIndex& index, const Vec3& middle, double scale, const Visit& visit) {
  const auto for_influences = [&](std::size_t i, const auto& use) {
    for (std::uint32_t k = rig.first_influence[i]; k < rig.first_influence[i + 1]; ++k) use(rig.influences[k]);
  };
  for (std::size_t i = 0; i < rig.bind.size(); ++i) {
    const Vec3& p = rig.bind[i];
    const std::array<double, 4> values{(p[0] - middle[0]) * scale, (p[1] - middle[1]) * scale,
                                       (p[2] - middle[2]) * scale, 1};
    for_influences(i, [&](const Rig::Influence& on) {
      visit(i, index.of_bone(on.bone), on.weight, std::span<const double>(values));
    });
  }
  for (std::size_t t = 0; t < rig.targets.size(); ++t) {
    const Rig::MorphTarget& target = rig.targets[t];
    for (std::size_t m = 0; m < target.vertices.size(); ++m) {
      const Vec3& d = target.offsets[m];
      const std::array<double, 3> values{d[0] * scale, d[1] * scale, d[2] * scale};
      for_influences(target.vertices[m], [&](const Rig::Influence& on) {
        visit(target.vertices[m], index.of_target(on.bone, t), on.weight, std::span<const double>(values));
      });
    }
  }
}

}  // namespace

Result<SpanningColumns> columns_from_rig(const Rig& rig) {
  const Box box = bounding_box(rig.bind);
  const double scale = box.diagonal() > 0 ? 2 / box.diagonal() : 1;
  Vec3 middle{};
  for (std::size_t axis = 0; axis < 3; ++axis) middle[axis] = (box.low[axis] + box.high[axis]) / 2;
  ColumnIndex index(rig.targets.size());
  for_each_entry(rig, index, middle, scale, [](auto&&...) {});  // numbers the columns
  const std::size_t c = index.count();
  const std::size_t n = rig.bind.size();
  if (c > SpanningColumns::kMaxColumns || c * n > SpanningColumns::kMaxBytes / sizeof(double)) {
    return fail(ErrorCode::kTooLarge, "the rig spans " + std::to_string(c) + " columns of " + std::to_string(n) +
                                          " vertices: at most " + std::to_string(SpanningColumns::kMaxColumns) +
                                          " and 2 GiB are made a basis; learn one from the clip (pca) instead");
  }
  SpanningColumns columns{c, std::vector<double>(n * c)};
  for_each_entry(rig, index, middle, scale,
                 [&](std::size_t i, std::size_t first, double weight, std::span<const double> values) {
                   for (std::size_t k = 0; k < values.size(); ++k) columns.W[i * c + first + k] += weight * values[k];
                 });
  return columns;
}

}  // namespace eigencast
