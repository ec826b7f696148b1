// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_scene.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <tuple>

#include "common/surface/vertex_normals.h"

namespace eigencast {
namespace {

// Below, at or above 0 as vertex a comes before b: equal ones are at one position and always move alike.
int order_of(const GltfParts& parts, std::size_t a, std::size_t b) {
  const GltfPart& A = parts.of(a);
  const GltfPart& B = parts.of(b);
  const std::size_t i = parts.local(a);
  const std::size_t j = parts.local(b);
  const auto order = [](const auto& x, const auto& y) { return x < y ? -1 : y < x ? 1 : 0; };
  if (const int by_place = order(A.positions[i], B.positions[j]); by_place != 0) return by_place;
  const auto& mine = A.influences[i];
  const auto& theirs = B.influences[j];
  if (mine.size() != theirs.size()) return mine.size() < theirs.size() ? -1 : 1;
  for (std::size_t k = 0; k < mine.size(); ++k) {
    if (const int by = order(std::tie(mine[k].bone, mine[k].weight), std::tie(theirs[k].bone, theirs[k].weight));
        by != 0)
      return by;
  }
  // Morph targets of different nodes are different targets.
  if (A.offsets.size() + B.offsets.size() > 0 && A.node != B.node) return A.node < B.node ? -1 : 1;
  for (std::size_t k = 0; k < A.offsets.size(); ++k) {
    if (const int by = order(A.offsets[k][i], B.offsets[k][j]); by != 0) return by;
  }
  return 0;
}

struct Welds {
  std::vector<std::uint32_t> number;        ///< Numbers each vertex after welding.
  std::vector<std::size_t> representative;  ///< Finds each welded one's first in the file.
  std::size_t torn = 0;                     ///< Vertices that share a position with one that moves otherwise.
};

Welds find_welds(const GltfParts& parts) {
  const std::size_t raw = parts.vertices();
  std::vector<std::uint32_t> sorted(raw);
  std::iota(sorted.begin(), sorted.end(), 0u);
  std::sort(sorted.begin(), sorted.end(), [&](std::uint32_t a, std::uint32_t b) {
    const int order = order_of(parts, a, b);
    return order != 0 ? order < 0 : a < b;
  });
  Welds welds;
  // first[v]: the first vertex of the file that is the same as v.
  std::vector<std::uint32_t> first(raw);
  const auto position = [&](std::uint32_t v) { return parts.of(v).positions[parts.local(v)]; };
  for (std::size_t k = 0; k < raw; ++k) {
    const bool same = k > 0 && order_of(parts, sorted[k - 1], sorted[k]) == 0;
    first[sorted[k]] = same ? first[sorted[k - 1]] : sorted[k];
    if (k > 0 && !same && position(sorted[k - 1]) == position(sorted[k])) ++welds.torn;
  }
  welds.number.resize(raw);
  for (std::size_t v = 0; v < raw; ++v) {
    if (first[v] == v) {
      welds.number[v] = static_cast<std::uint32_t>(welds.representative.size());
      welds.representative.push_back(v);
    } else {
      welds.number[v] = welds.number[first[v]];
    }
  }
  return welds;
}

void renumber_faces(const GltfParts& parts, const Welds& welds, GltfScene& scene) {
  const std::vector<std::uint32_t>& number = welds.number;
  Appearance& appearance = scene.appearance;
  VertexNormalsFinder finder(welds.representative.size());
  std::size_t kept = 0;
  for (std::size_t f = 0; f < scene.faces.size(); ++f) {
    const Face face{number[scene.faces[f][0]], number[scene.faces[f][1]], number[scene.faces[f][2]]};
    if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0]) continue;
    for (const std::uint32_t v : scene.faces[f]) {
      const std::vector<Vec3>& normals = parts.of(v).normals;
      finder.add_corner(number[v], normals.empty() ? Vec3{} : normals[parts.local(v)]);
    }
    scene.faces[kept] = face;
    if (!appearance.corner_uv.empty()) appearance.corner_uv[kept] = appearance.corner_uv[f];
    if (!appearance.corner_colour.empty()) appearance.corner_colour[kept] = appearance.corner_colour[f];
    appearance.face_material[kept] = appearance.face_material[f];
    ++kept;
  }
  if (kept < scene.faces.size()) {
    scene.notes.push_back(std::to_string(scene.faces.size() - kept) +
                          " faces with two corners at one position left out");
  }
  appearance.vertex_normals = finder.take();
  scene.faces.resize(kept);
  appearance.face_material.resize(kept);
  if (!appearance.corner_uv.empty()) appearance.corner_uv.resize(kept);
  if (!appearance.corner_colour.empty()) appearance.corner_colour.resize(kept);
}

void fill_rig(const GltfParts& parts, const std::vector<std::size_t>& representative, GltfScene& scene) {
  const std::size_t n = representative.size();
  Rig& rig = scene.rig;
  rig.bind.reserve(n);
  rig.first_influence.reserve(n + 1);
  rig.first_influence.push_back(0);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t v = representative[i];
    const GltfPart& part = parts.of(v);
    const std::size_t at = parts.local(v);
    rig.bind.push_back(part.positions[at]);
    rig.influences.insert(rig.influences.end(), part.influences[at].begin(), part.influences[at].end());
    rig.first_influence.push_back(static_cast<std::uint32_t>(rig.influences.size()));
    for (std::size_t k = 0; k < part.offsets.size(); ++k) {
      const Vec3& offset = part.offsets[k][at];
      if (offset == Vec3{0, 0, 0}) continue;
      Rig::MorphTarget& target = rig.targets[scene.nodes[part.node].first_target + k];
      target.vertices.push_back(static_cast<std::uint32_t>(i));
      target.offsets.push_back(offset);
    }
  }
}

Matrix4 product(const Matrix4& a, const Matrix4& b) {
  Matrix4 c{};
  for (std::size_t column = 0; column < 4; ++column) {
    for (std::size_t k = 0; k < 4; ++k) {
      for (std::size_t row = 0; row < 4; ++row) c[4 * column + row] += a[4 * k + row] * b[4 * column + k];
    }
  }
  return c;
}

Matrix4 matrix_from_local(const GltfPose::Local& local) {
  const auto [x, y, z, w] = local.rotation;
  const Vec3& s = local.scale;
  const Vec3& t = local.translation;
  return {(1 - 2 * (y * y + z * z)) * s[0],
          2 * (x * y + w * z) * s[0],
          2 * (x * z - w * y) * s[0],
          0,
          2 * (x * y - w * z) * s[1],
          (1 - 2 * (x * x + z * z)) * s[1],
          2 * (y * z + w * x) * s[1],
          0,
          2 * (x * z + w * y) * s[2],
          2 * (y * z - w * x) * s[2],
          (1 - 2 * (x * x + y * y)) * s[2],
          0,
          t[0],
          t[1],
          t[2],
          1};
}

std::vector<Matrix4> bone_matrices(const GltfScene& scene, const GltfPose& pose) {
  std::vector<Matrix4> global(scene.nodes.size());
  for (const std::size_t i : scene.parents_first) {
    const GltfScene::Node& node = scene.nodes[i];
    const Matrix4 local = node.fixed ? node.matrix : matrix_from_local(pose.nodes[i]);
    global[i] = node.parent < 0 ? local : product(global[static_cast<std::size_t>(node.parent)], local);
  }
  std::vector<Matrix4> matrices;
  matrices.reserve(scene.bones.size());
  for (const GltfScene::Bone& bone : scene.bones) matrices.push_back(product(global[bone.node], bone.inverse_bind));
  return matrices;
}

}  // namespace

void weld(const GltfParts& parts, GltfScene& scene) {
  const Welds welds = find_welds(parts);
  if (const std::size_t n = welds.representative.size(); n < parts.vertices()) {
    scene.notes.push_back(std::to_string(parts.vertices()) + " vertices welded to " + std::to_string(n) +
                          ": the file repeats them along seams");
  }
  if (welds.torn > 0) {
    scene.notes.push_back(std::to_string(welds.torn) +
                          " vertices share a position with one that moves otherwise; they stay apart");
  }
  renumber_faces(parts, welds, scene);
  fill_rig(parts, welds.representative, scene);
}

Result<std::vector<Vec3>> GltfScene::positions(const GltfPose& pose) const {
  std::vector<Vec3> morphed = rig.bind;
  for (std::size_t k = 0; k < rig.targets.size(); ++k) {
    const Rig::MorphTarget& target = rig.targets[k];
    for (std::size_t i = 0; pose.weights[k] != 0 && i < target.vertices.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) morphed[target.vertices[i]][c] += pose.weights[k] * target.offsets[i][c];
    }
  }
  const std::vector<Matrix4> matrices = bone_matrices(*this, pose);
  for (std::size_t i = 0; i < morphed.size(); ++i) {
    const Vec3 p = morphed[i];
    Vec3 sum{0, 0, 0};
    for (std::uint32_t k = rig.first_influence[i]; k < rig.first_influence[i + 1]; ++k) {
      const Matrix4& B = matrices[rig.influences[k].bone];
      const double weight = rig.influences[k].weight;
      for (std::size_t c = 0; c < 3; ++c)
        sum[c] += weight * (B[c] * p[0] + B[4 + c] * p[1] + B[8 + c] * p[2] + B[12 + c]);
    }
    for (std::size_t c = 0; c < 3; ++c) {
      morphed[i][c] = static_cast<float>(sum[c]);
      if (!std::isfinite(morphed[i][c]))
        return fail(ErrorCode::kCorrupt, "vertex " + std::to_string(i) + " is not finite");
    }
  }
  return morphed;
}

}  // namespace eigencast
