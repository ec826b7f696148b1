// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_pose.h"

#include <cmath>

namespace eigencast {
namespace {

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
