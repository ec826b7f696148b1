// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf_scene.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <string>
#include <utility>

namespace eigencast {
namespace {

constexpr Matrix4 kIdentity{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
constexpr std::size_t kMaxNodes = 100'000;
constexpr std::size_t kMaxInstances = 10'000;

class Builder {
 public:
  Builder(const tinygltf::Model& model, GltfNumbers& numbers) : model_(model), numbers_(numbers) {}

  Result<GltfScene> build() {
    if (const auto added = add_nodes(); !added) return added.error();
    const auto nodes = nodes_of_scene();
    if (!nodes) return nodes.error();
    std::size_t instances = 0;
    for (const std::size_t node : *nodes) {
      if (model_.nodes[node].mesh < 0) continue;
      if (++instances > kMaxInstances)
        return fail(ErrorCode::kTooLarge, "more than " + std::to_string(kMaxInstances) + " meshes");
      if (const auto added = add_instance(node); !added) return added.error();
    }
    if (parts_.vertices() == 0) return fail(ErrorCode::kUnsupported, "no triangles and no points in its scene");
    if (parts_.size() > 1) {
      scene_.notes.push_back(std::to_string(parts_.size()) + " parts of " + std::to_string(instances) +
                             " nodes taken as one surface");
    }
    if (skipped_ > 0)
      scene_.notes.push_back(std::to_string(skipped_) + " parts are lines or have no positions: left out");
    weld(parts_, scene_);
    if (const auto appearance = add_appearance(); !appearance) return appearance.error();
    return std::move(scene_);
  }

 private:
  Result<void> add_nodes() {
    if (model_.nodes.size() > kMaxNodes)
      return fail(ErrorCode::kTooLarge, "more than " + std::to_string(kMaxNodes) + " nodes");
    scene_.nodes.resize(model_.nodes.size());
    scene_.rest.nodes.resize(model_.nodes.size());
    for (std::size_t i = 0; i < model_.nodes.size(); ++i) {
      if (const auto added = add_rest_of_node(model_.nodes[i], i); !added) return added;
      for (const int child : model_.nodes[i].children) {
        if (element(scene_.nodes, child) == nullptr)
          return corrupt_gltf("node " + std::to_string(i) + ": no child " + std::to_string(child));
        int& parent = scene_.nodes[static_cast<std::size_t>(child)].parent;
        if (parent >= 0) return corrupt_gltf("node " + std::to_string(child) + " has two parents");
        parent = static_cast<int>(i);
      }
    }
    return order_nodes();
  }

  Result<void> order_nodes() {
    std::vector<std::size_t>& order = scene_.parents_first;
    for (std::size_t i = 0; i < scene_.nodes.size(); ++i) {
      if (scene_.nodes[i].parent < 0) order.push_back(i);
    }
    for (std::size_t k = 0; k < order.size(); ++k) {
      for (const int child : model_.nodes[order[k]].children) order.push_back(static_cast<std::size_t>(child));
    }
    // What no root reaches goes round in a ring.
    return order.size() == scene_.nodes.size() ? Result<void>() : corrupt_gltf("nodes are their own ancestors");
  }

  Result<void> add_rest_of_node(const tinygltf::Node& node, std::size_t index) {
    const auto finite = [](const std::vector<double>& values) {
      return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x) && std::abs(x) < 1e30; });
    };
    const auto is_sized = [](const std::vector<double>& values, std::size_t size) {
      return values.empty() || values.size() == size;
    };
    const bool sound = is_sized(node.matrix, 16) && is_sized(node.translation, 3) && is_sized(node.rotation, 4) &&
                       is_sized(node.scale, 3) && finite(node.matrix) && finite(node.translation) &&
                       finite(node.rotation) && finite(node.scale) && finite(node.weights);
    if (!sound) return corrupt_gltf("node " + std::to_string(index) + ": its transform cannot be meant");
    GltfScene::Node& mine = scene_.nodes[index];
    mine.fixed = !node.matrix.empty();
    if (mine.fixed) std::copy(node.matrix.begin(), node.matrix.end(), mine.matrix.begin());
    GltfPose::Local& local = scene_.rest.nodes[index];
    if (!node.translation.empty())
      std::copy(node.translation.begin(), node.translation.end(), local.translation.begin());
    if (!node.scale.empty()) std::copy(node.scale.begin(), node.scale.end(), local.scale.begin());
    if (!node.rotation.empty()) {
      const double length =
          std::sqrt(std::inner_product(node.rotation.begin(), node.rotation.end(), node.rotation.begin(), 0.0));
      for (std::size_t c = 0; c < 4 && length > 1e-12; ++c) local.rotation[c] = node.rotation[c] / length;
    }
    return {};
  }

  Result<std::vector<std::size_t>> nodes_of_scene() const {
    std::vector<std::size_t> found;
    if (model_.scenes.empty()) {
      found = scene_.parents_first;
      return found;
    }
    const auto index = static_cast<std::size_t>(std::max(0, model_.defaultScene));
    if (index >= model_.scenes.size()) return corrupt_gltf("no scene " + std::to_string(index));
    std::vector<bool> seen(scene_.nodes.size());
    for (const int root : model_.scenes[index].nodes) {
      if (element(model_.nodes, root) == nullptr) return corrupt_gltf("the scene has no node " + std::to_string(root));
      found.push_back(static_cast<std::size_t>(root));
    }
    for (std::size_t k = 0; k < found.size(); ++k) {
      if (seen[found[k]]) return corrupt_gltf("node " + std::to_string(found[k]) + " is in the scene twice");
      seen[found[k]] = true;
      for (const int child : model_.nodes[found[k]].children) found.push_back(static_cast<std::size_t>(child));
    }
    std::sort(found.begin(), found.end());
    return found;
  }

  Result<void> add_instance(std::size_t index) {
    const tinygltf::Node& node = model_.nodes[index];
    const tinygltf::Mesh* mesh = element(model_.meshes, node.mesh);
    if (mesh == nullptr)
      return corrupt_gltf("node " + std::to_string(index) + ": no mesh " + std::to_string(node.mesh));
    GltfScene::Node& mine = scene_.nodes[index];
    mine.first_target = scene_.rig.targets.size();
    for (const tinygltf::Primitive& primitive : mesh->primitives)
      mine.target_count = std::max(mine.target_count, primitive.targets.size());
    if (scene_.rig.targets.size() + mine.target_count > kMaxNodes)
      return fail(ErrorCode::kTooLarge, "too many morph targets");
    const std::vector<double>& weights = node.weights.empty() ? mesh->weights : node.weights;
    for (std::size_t k = 0; k < mine.target_count; ++k) {
      scene_.rig.targets.push_back({mesh->name + " " + std::to_string(k), {}, {}});
      scene_.rest.weights.push_back(k < weights.size() && std::isfinite(weights[k]) ? weights[k] : 0);
    }
    for (const tinygltf::Primitive& primitive : mesh->primitives) {
      if (const auto added = add_primitive(primitive, index); !added)
        return in_context("mesh " + std::to_string(node.mesh), added.error());
    }
    return {};
  }

  Result<void> add_primitive(const tinygltf::Primitive& primitive, std::size_t node) {
    const int mode = primitive.mode;
    const bool has_faces = mode == -1 || (mode >= TINYGLTF_MODE_TRIANGLES && mode <= TINYGLTF_MODE_TRIANGLE_FAN);
    const auto position_at = primitive.attributes.find("POSITION");
    if ((!has_faces && mode != TINYGLTF_MODE_POINTS) || position_at == primitive.attributes.end()) {
      ++skipped_;
      return {};
    }
    if (numbers_.count(position_at->second) + parts_.vertices() > kMaxSurfaceVertices) {
      return fail(ErrorCode::kTooLarge, "more than " + std::to_string(kMaxSurfaceVertices) + " vertices");
    }
    const auto positions = numbers_.read(position_at->second, 3);
    if (!positions) return positions.error();
    const std::size_t n = positions->count;
    GltfPart part;
    part.node = node;
    const auto to_vectors = [n](const GltfNumbers::Array& array) {
      std::vector<Vec3> vectors(n);
      // Adding zero makes one zero of the two.
      for (std::size_t k = 0; k < 3 * n; ++k) vectors[k / 3][k % 3] = array.values[k] + 0.0;
      return vectors;
    };
    part.positions = to_vectors(*positions);
    if (const auto good = store(part.influences, influences_of(primitive, node, n)); !good) return good;
    for (std::size_t k = 0; k < scene_.nodes[node].target_count; ++k) {
      if (n > offsets_left_) return fail(ErrorCode::kTooLarge, "too many morph targets");
      offsets_left_ -= n;
      std::vector<Vec3> offsets(n);
      if (k < primitive.targets.size()) {
        const auto at = primitive.targets[k].find("POSITION");
        if (at != primitive.targets[k].end()) {
          const auto read = numbers_.read(at->second, 3);
          if (!read) return read.error();
          if (read->count != n)
            return corrupt_gltf("morph target " + std::to_string(k) + " is not one offset a vertex");
          offsets = to_vectors(*read);
        }
      }
      part.offsets.push_back(std::move(offsets));
    }
    std::vector<Face> faces;
    if (has_faces) {
      if (const auto good = store(faces, faces_of(primitive, n)); !good) return good;
      if (const auto added = add_corners(primitive, faces, n); !added) return added;
      const auto normal_at = primitive.attributes.find("NORMAL");
      if (normal_at != primitive.attributes.end()) {
        const auto normals = numbers_.read(normal_at->second, 3, 0, GltfNumbers::Values::kAny);
        if (!normals) return normals.error();
        if (normals->count != n) return corrupt_gltf("normals are not one a vertex");
        part.normals = to_vectors(*normals);
      }
    }
    const auto base = static_cast<std::uint32_t>(parts_.vertices());
    for (const Face& f : faces) scene_.faces.push_back({f[0] + base, f[1] + base, f[2] + base});
    parts_.add(std::move(part));
    return {};
  }

  Result<std::vector<std::vector<Rig::Influence>>> influences_of(const tinygltf::Primitive& primitive, std::size_t node,
                                                                 std::size_t vertices) {
    using Influences = std::vector<std::vector<Rig::Influence>>;
    const int skin = model_.nodes[node].skin;
    const bool skinned =
        skin >= 0 && primitive.attributes.count("JOINTS_0") > 0 && primitive.attributes.count("WEIGHTS_0") > 0;
    if (!skinned) return Influences(vertices, {{static_cast<std::uint32_t>(bone_of_node(node)), 1}});
    const auto first = first_bone_of_skin(skin);
    if (!first) return first.error();
    const std::size_t joints = model_.skins[static_cast<std::size_t>(skin)].joints.size();
    Influences all(vertices);
    for (int set = 0; set < 4; ++set) {
      const auto joint_at = primitive.attributes.find("JOINTS_" + std::to_string(set));
      const auto weight_at = primitive.attributes.find("WEIGHTS_" + std::to_string(set));
      if (joint_at == primitive.attributes.end() || weight_at == primitive.attributes.end()) break;
      const auto joint = numbers_.read(joint_at->second, 4);
      if (!joint) return joint.error();
      const auto weight = numbers_.read(weight_at->second, 4);
      if (!weight) return weight.error();
      if (joint->count != vertices || weight->count != vertices)
        return corrupt_gltf("joints or weights are not one a vertex");
      for (std::size_t k = 0; k < 4 * vertices; ++k) {
        if (weight->values[k] <= 0) continue;
        if (!(joint->values[k] >= 0 && joint->values[k] < static_cast<double>(joints))) {
          return corrupt_gltf("vertex " + std::to_string(k / 4) + " refers to joint " +
                              std::to_string(joint->values[k]) + " of " + std::to_string(joints));
        }
        all[k / 4].push_back(
            {static_cast<std::uint32_t>(*first + static_cast<std::size_t>(joint->values[k])), weight->values[k]});
      }
    }
    for (std::vector<Rig::Influence>& mine : all) {
      if (mine.empty()) mine.push_back({static_cast<std::uint32_t>(bone_of_node(node)), 1});
      std::sort(mine.begin(), mine.end(), [](const auto& a, const auto& b) { return a.bone < b.bone; });
      const double sum =
          std::accumulate(mine.begin(), mine.end(), 0.0, [](double s, const auto& i) { return s + i.weight; });
      for (Rig::Influence& influence : mine) influence.weight /= sum;
    }
    return all;
  }

  Result<std::size_t> first_bone_of_skin(int index) {
    if (const auto found = skin_bones_.find(index); found != skin_bones_.end()) return found->second;
    const tinygltf::Skin* skin = element(model_.skins, index);
    if (skin == nullptr) return corrupt_gltf("no skin " + std::to_string(index));
    std::optional<GltfNumbers::Array> inverse;
    if (skin->inverseBindMatrices >= 0) {
      auto matrices = numbers_.read(skin->inverseBindMatrices, 16);
      if (!matrices) return matrices.error();
      if (matrices->count < skin->joints.size())
        return corrupt_gltf("skin " + std::to_string(index) + " has fewer matrices than joints");
      inverse = std::move(*matrices);
    }
    const std::size_t first = scene_.bones.size();
    if (skin->joints.size() > kMaxNodes) return fail(ErrorCode::kTooLarge, "too many joints");
    for (std::size_t k = 0; k < skin->joints.size(); ++k) {
      if (element(scene_.nodes, skin->joints[k]) == nullptr)
        return corrupt_gltf("skin " + std::to_string(index) + ": no node " + std::to_string(skin->joints[k]));
      GltfScene::Bone bone{static_cast<std::size_t>(skin->joints[k]), kIdentity};
      if (inverse)
        std::copy_n(inverse->values.begin() + static_cast<std::ptrdiff_t>(16 * k), 16, bone.inverse_bind.begin());
      scene_.rig.bones.push_back(model_.nodes[bone.node].name);
      scene_.bones.push_back(bone);
    }
    skin_bones_[index] = first;
    return first;
  }

  std::size_t bone_of_node(std::size_t node) {
    const auto [at, added] = node_bones_.try_emplace(node, scene_.bones.size());
    if (added) {
      scene_.bones.push_back({node, kIdentity});
      scene_.rig.bones.push_back(model_.nodes[node].name);
    }
    return at->second;
  }

  Result<std::vector<Face>> faces_of(const tinygltf::Primitive& primitive, std::size_t vertices) {
    std::vector<std::uint32_t> indices;
    if (primitive.indices >= 0) {
      if (const auto good = store(indices, numbers_.read_indices(primitive.indices)); !good) return good.error();
      for (const std::uint32_t index : indices) {
        if (index >= vertices)
          return corrupt_gltf("a face refers to vertex " + std::to_string(index) + " of " + std::to_string(vertices));
      }
    } else {
      indices.resize(vertices);
      std::iota(indices.begin(), indices.end(), 0u);
    }
    std::vector<Face> faces;
    const bool list = primitive.mode == TINYGLTF_MODE_TRIANGLES || primitive.mode == -1;
    for (std::size_t k = 2; k < indices.size(); k += list ? 3 : 1) {
      if (list) {
        faces.push_back({indices[k - 2], indices[k - 1], indices[k]});
      } else if (primitive.mode == TINYGLTF_MODE_TRIANGLE_FAN) {
        faces.push_back({indices[0], indices[k - 1], indices[k]});
      } else {
        const bool odd = k % 2 == 1;
        faces.push_back({indices[k - 2], indices[odd ? k : k - 1], indices[odd ? k - 1 : k]});
      }
    }
    if (scene_.faces.size() + faces.size() > kMaxSurfaceFaces) return fail(ErrorCode::kTooLarge, "too many faces");
    return faces;
  }

  Result<void> add_corners(const tinygltf::Primitive& primitive, const std::vector<Face>& faces, std::size_t vertices) {
    Appearance& appearance = scene_.appearance;
    std::optional<GltfNumbers::Array> uv, colour;
    if (const auto at = primitive.attributes.find("TEXCOORD_0"); at != primitive.attributes.end()) {
      auto read = numbers_.read(at->second, 2);
      if (!read) return read.error();
      uv = std::move(*read);
    }
    if (const auto at = primitive.attributes.find("COLOR_0"); at != primitive.attributes.end()) {
      auto read = numbers_.read(at->second, 3, 4);
      if (!read) return read.error();
      colour = std::move(*read);
    }
    if ((uv && uv->count != vertices) || (colour && colour->count != vertices)) {
      return corrupt_gltf("texture coordinates or colours are not one a vertex");
    }
    // Arrays begin where the first primitive states something; faces of those that do not get zero, or white.
    const std::size_t before = scene_.faces.size();
    const std::array<float, 4> white{1, 1, 1, 1};
    if (uv || !appearance.corner_uv.empty()) appearance.corner_uv.resize(before + faces.size());
    if (colour || !appearance.corner_colour.empty())
      appearance.corner_colour.resize(before + faces.size(), {white, white, white});
    for (std::size_t f = 0; f < faces.size(); ++f) {
      for (std::size_t k = 0; k < 3; ++k) {
        for (std::size_t c = 0; uv && c < 2; ++c)
          appearance.corner_uv[before + f][k][c] = static_cast<float>(uv->values[2 * faces[f][k] + c]);
        for (std::size_t c = 0; colour && c < colour->width; ++c) {
          appearance.corner_colour[before + f][k][c] =
              static_cast<float>(colour->values[colour->width * faces[f][k] + c]);
        }
      }
    }
    appearance.face_material.resize(before + faces.size(), -1);
    const bool known = element(model_.materials, primitive.material) != nullptr;
    std::fill(appearance.face_material.begin() + static_cast<std::ptrdiff_t>(before), appearance.face_material.end(),
              known ? primitive.material : -1);
    return {};
  }

  Result<void> add_appearance() {
    for (const tinygltf::Image& image : model_.images) {
      Appearance::Image mine{image.name.empty() ? image.uri : image.name, image.mimeType, image.image};
      if (image.bufferView >= 0) {
        const auto good = store(mine.bytes, numbers_.bytes_of_view(image.bufferView));
        if (!good) return in_context("image", good.error());
      }
      scene_.appearance.images.push_back(std::move(mine));
    }
    for (const tinygltf::Material& material : model_.materials) {
      Appearance::Material mine;
      mine.name = material.name;
      const auto& factor = material.pbrMetallicRoughness.baseColorFactor;
      for (std::size_t c = 0; c < 4 && factor.size() == 4; ++c) mine.base_colour[c] = static_cast<float>(factor[c]);
      const auto* texture = element(model_.textures, material.pbrMetallicRoughness.baseColorTexture.index);
      if (texture != nullptr && element(model_.images, texture->source) != nullptr) mine.image = texture->source;
      scene_.appearance.materials.push_back(std::move(mine));
    }
    find_missing();
    note_other_images(scene_.appearance);
    return {};
  }

  /// Images of materials that faces have.
  void find_missing() {
    Appearance& appearance = scene_.appearance;
    std::set<int> used;
    for (const int material : std::set<int>(appearance.face_material.begin(), appearance.face_material.end()))
      used.insert(material < 0 ? -1 : appearance.materials[static_cast<std::size_t>(material)].image);
    for (const int number : used) {
      if (number < 0) continue;
      const Appearance::Image& image = appearance.images[static_cast<std::size_t>(number)];
      const auto usable = check_image(image);
      if (usable) continue;
      const bool empty = image.bytes.empty();
      const std::string why = "image " + quoted_name(image.name) + " is not there, or not below the file's folder";
      appearance.missing.push_back((empty ? why : usable.error().message) + ": drawn without it");
    }
  }

  const tinygltf::Model& model_;
  GltfNumbers& numbers_;
  GltfScene scene_;
  GltfParts parts_;
  std::map<int, std::size_t> skin_bones_;
  std::map<std::size_t, std::size_t> node_bones_;
  std::size_t skipped_ = 0;
  std::size_t offsets_left_ = std::size_t{1} << 26;
};

}  // namespace

Result<GltfScene> gltf_scene_from_model(const tinygltf::Model& model, GltfNumbers& numbers) {
  return Builder(model, numbers).build();
}

}  // namespace eigencast
