// SPDX-License-Identifier: MIT
#include "common/surface/formats/morph.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <span>
#include <sstream>
#include <tuple>
#include <utility>

#include "common/core/files.h"
#include "common/surface/appearance.h"
#include "common/surface/formats/gltf_file.h"

namespace eigencast {
namespace {

constexpr std::size_t kMostBytes = std::size_t{1} << 31;

/// Vertices as glTF has them: one for each vertex and texture coordinate at its corners.
struct SplitVertices {
  std::vector<std::uint32_t> source;
  std::vector<std::array<float, 2>> uvs;                  ///< As many, or none.
  std::map<int, std::vector<std::uint32_t>> by_material;  ///< Corners.
};

SplitVertices split(const Surface& rest, const Appearance* look) {
  SplitVertices result;
  if (look == nullptr || look->corner_uv.empty()) {
    for (std::uint32_t i = 0; i < rest.vertex_count(); ++i) result.source.push_back(i);
    std::vector<std::uint32_t>& corners = result.by_material[-1];
    for (const Face& face : rest.faces) corners.insert(corners.end(), face.begin(), face.end());
    return result;
  }
  std::map<std::tuple<std::uint32_t, float, float>, std::uint32_t> known;
  for (std::size_t f = 0; f < rest.faces.size(); ++f) {
    for (std::size_t c = 0; c < 3; ++c) {
      const auto& uv = look->corner_uv[f][c];
      const auto [at, is_new] =
          known.try_emplace({rest.faces[f][c], uv[0], uv[1]}, static_cast<std::uint32_t>(result.source.size()));
      if (is_new) result.source.push_back(rest.faces[f][c]), result.uvs.push_back(uv);
      result.by_material[look->face_material.empty() ? -1 : look->face_material[f]].push_back(at->second);
    }
  }
  return result;
}

/// A file's one buffer, with a view for each array.
class Arrays {
 public:
  explicit Arrays(tinygltf::Model& model) : model_(model) { model_.buffers.emplace_back(); }

  template <typename Value>
  int add(std::span<const Value> values, int target = 0) {
    std::vector<unsigned char>& data = model_.buffers[0].data;
    data.resize((data.size() + 3) / 4 * 4);
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = data.size();
    view.byteLength = values.size_bytes();
    view.target = target;
    data.resize(data.size() + values.size_bytes());
    if (!values.empty()) std::memcpy(data.data() + view.byteOffset, values.data(), values.size_bytes());
    model_.bufferViews.push_back(std::move(view));
    return static_cast<int>(model_.bufferViews.size()) - 1;
  }
  int accessor(int view, int type, int component, std::size_t count) {
    tinygltf::Accessor accessor;
    accessor.bufferView = view;
    accessor.type = type;
    accessor.componentType = component;
    accessor.count = count;
    model_.accessors.push_back(std::move(accessor));
    return static_cast<int>(model_.accessors.size()) - 1;
  }
  int numbers(std::span<const float> values) {
    const int made = accessor(add(values), TINYGLTF_TYPE_SCALAR, TINYGLTF_COMPONENT_TYPE_FLOAT, values.size());
    const auto [low, high] = std::minmax_element(values.begin(), values.end());
    model_.accessors.back().minValues = {double{*low}};
    model_.accessors.back().maxValues = {double{*high}};
    return made;
  }
  /// Values of the vertices that `of` names.
  template <typename Triple>
  int triples(std::span<const std::uint32_t> of, const Triple& value) {
    std::vector<float> flat;
    flat.reserve(3 * of.size());
    std::vector<double> low(3, HUGE_VAL), high(3, -HUGE_VAL);
    for (const std::uint32_t i : of) {
      for (std::size_t c = 0; c < 3; ++c) {
        flat.push_back(value(i, c));
        low[c] = std::min(low[c], double{flat.back()}), high[c] = std::max(high[c], double{flat.back()});
      }
    }
    const int made = accessor(add(std::span<const float>(flat), TINYGLTF_TARGET_ARRAY_BUFFER), TINYGLTF_TYPE_VEC3,
                              TINYGLTF_COMPONENT_TYPE_FLOAT, of.size());
    model_.accessors.back().minValues = low;
    model_.accessors.back().maxValues = high;
    return made;
  }

 private:
  tinygltf::Model& model_;
};

void add_materials(const Appearance& look, Arrays& arrays, tinygltf::Model& model) {
  for (const Appearance::Image& image : look.images) {
    tinygltf::Image stored;
    stored.name = image.name;
    stored.mimeType = image.mime_type;
    stored.bufferView = arrays.add(std::span<const std::uint8_t>(image.bytes));
    model.images.push_back(std::move(stored));
    tinygltf::Texture texture;
    texture.source = static_cast<int>(model.images.size()) - 1;
    model.textures.push_back(std::move(texture));
  }
  for (const Appearance::Material& material : look.materials) {
    tinygltf::Material stored;
    stored.name = material.name;
    stored.doubleSided = true;
    stored.pbrMetallicRoughness.metallicFactor = 0;
    stored.pbrMetallicRoughness.baseColorFactor.assign(material.base_colour.begin(), material.base_colour.end());
    stored.pbrMetallicRoughness.baseColorTexture.index = material.image;
    model.materials.push_back(std::move(stored));
  }
}

tinygltf::Animation animation_of(const MotionClip& clip, const MorphedMotion& motion, Arrays& arrays) {
  std::vector<float> times;
  for (std::size_t t = 0; t < motion.frames; ++t)
    times.push_back(static_cast<float>(static_cast<double>(t) / clip.frame_rate_hz()));
  tinygltf::AnimationSampler sampler;
  sampler.input = arrays.numbers(times);
  sampler.output = arrays.accessor(arrays.add(std::span<const float>(motion.weights)), TINYGLTF_TYPE_SCALAR,
                                   TINYGLTF_COMPONENT_TYPE_FLOAT, motion.weights.size());
  sampler.interpolation = "LINEAR";
  tinygltf::AnimationChannel channel;
  channel.sampler = 0;
  channel.target_node = 0;
  channel.target_path = "weights";
  tinygltf::Animation animation;
  animation.name = "motion";
  animation.samplers.push_back(std::move(sampler));
  animation.channels.push_back(std::move(channel));
  return animation;
}

}  // namespace

Result<void> write_morphed(const MotionClip& clip, const MorphedMotion& motion, const std::string& path) {
  const Surface& rest = clip.rest();
  const Appearance* look = clip.appearance();
  const SplitVertices vertices = split(rest, look);
  const std::size_t n = vertices.source.size();
  if (12 * n * (motion.targets + 1) + 4 * motion.weights.size() > kMostBytes)
    return fail(ErrorCode::kTooLarge, path + ": " + std::to_string(motion.targets) + " targets of " +
                                          std::to_string(n) +
                                          " vertices take more than 2 GiB; ask for fewer with --targets or --level");
  tinygltf::Model model;
  model.asset.version = "2.0";
  model.asset.generator = "eigencast";
  Arrays arrays(model);
  if (look != nullptr) add_materials(*look, arrays, model);

  tinygltf::Primitive all;
  all.attributes["POSITION"] = arrays.triples(
      vertices.source, [&](std::uint32_t i, std::size_t c) { return motion.base[3 * std::size_t{i} + c]; });
  if (!vertices.uvs.empty())
    all.attributes["TEXCOORD_0"] =
        arrays.accessor(arrays.add(std::span<const std::array<float, 2>>(vertices.uvs), TINYGLTF_TARGET_ARRAY_BUFFER),
                        TINYGLTF_TYPE_VEC2, TINYGLTF_COMPONENT_TYPE_FLOAT, n);
  const bool has_image = look != nullptr && !look->images.empty() && !vertices.uvs.empty();
  const auto colours = look != nullptr && !has_image ? stated_colours(rest, *look) : decltype(look->vertex_colour){};
  if (!colours.empty())
    all.attributes["COLOR_0"] = arrays.triples(vertices.source, [&](std::uint32_t i, std::size_t c) {
      return linear_from_srgb(static_cast<float>(colours[i][c]) / 255);
    });
  for (std::size_t k = 0; k < motion.targets; ++k) {
    const float* offsets = &motion.offsets[3 * k * rest.vertex_count()];
    all.targets.push_back({{"POSITION", arrays.triples(vertices.source, [&](std::uint32_t i, std::size_t c) {
                              return offsets[3 * std::size_t{i} + c];
                            })}});
  }
  tinygltf::Mesh mesh;
  mesh.weights.assign(motion.weights.begin(), motion.weights.begin() + static_cast<std::ptrdiff_t>(motion.targets));
  for (const auto& [material, corners] : vertices.by_material) {
    tinygltf::Primitive primitive = all;
    primitive.material = colours.empty() ? material : -1;
    primitive.mode = rest.is_point_cloud() ? TINYGLTF_MODE_POINTS : TINYGLTF_MODE_TRIANGLES;
    if (!rest.is_point_cloud())
      primitive.indices =
          arrays.accessor(arrays.add(std::span<const std::uint32_t>(corners), TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER),
                          TINYGLTF_TYPE_SCALAR, TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, corners.size());
    mesh.primitives.push_back(std::move(primitive));
  }
  model.meshes.push_back(std::move(mesh));
  tinygltf::Node node;
  node.mesh = 0;
  model.nodes.push_back(std::move(node));
  model.animations.push_back(animation_of(clip, motion, arrays));
  tinygltf::Scene scene;
  scene.nodes.push_back(0);
  model.scenes.push_back(std::move(scene));
  model.defaultScene = 0;

  std::ostringstream out;
  tinygltf::TinyGLTF writer;
  if (!writer.WriteGltfSceneToStream(&model, out, false, true))
    return fail(ErrorCode::kInternal, path + ": tinygltf could not write it");
  return write_file_atomically(path, std::move(out).str());
}

}  // namespace eigencast
