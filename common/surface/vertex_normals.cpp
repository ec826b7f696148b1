// SPDX-License-Identifier: MIT
#include "common/surface/vertex_normals.h"

#include <cmath>
#include <utility>

#include "common/surface/vector.h"

namespace eigencast {
namespace {

bool agree(const std::array<float, 3>& a, const std::array<float, 3>& b) {
  static const float least = static_cast<float>(std::cos(VertexNormalsFinder::kMaxAngleDeg / 57.29577951));
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] >= least;
}

}  // namespace

void VertexNormalsFinder::add_corner(std::uint32_t vertex, const Vec3& normal) {
  Found& found = found_[vertex];
  const double size = length(normal);
  if (!(size > 0 && std::isfinite(size))) {
    found = Found::kGap;
    return;
  }
  std::array<float, 3> own{};
  for (std::size_t c = 0; c < 3; ++c) own[c] = static_cast<float>(normal[c] / size);
  if (!std::exchange(has_any_, true)) any_ = own;
  has_two_ = has_two_ || !agree(own, any_);
  if (found == Found::kNothing) first_[vertex] = own, found = Found::kOne;
  if (found == Found::kOne && !agree(own, first_[vertex])) found = Found::kSeveral;
}

std::vector<VertexNormals> VertexNormalsFinder::take() const {
  if (!has_two_) return {};
  std::vector<VertexNormals> normals;
  normals.reserve(found_.size());
  for (const Found found : found_) {
    normals.push_back(found == Found::kOne       ? VertexNormals::kAgree
                      : found == Found::kSeveral ? VertexNormals::kDiffer
                                                 : VertexNormals::kNone);
  }
  return normals;
}

}  // namespace eigencast
