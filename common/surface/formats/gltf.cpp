// SPDX-License-Identifier: MIT
#include "common/surface/formats/gltf.h"

#include <cassert>
#include <cmath>
#include <filesystem>

#include "common/surface/formats/file_text.h"
#include "common/surface/formats/gltf_animation.h"
#include "common/surface/formats/gltf_scene.h"

namespace eigencast {
namespace {

struct GltfMotion {
  GltfScene scene;
  GltfAnimation animation;
  Surface rest;
  std::size_t frames;
  double rate_hz;
  std::string name;
};

class GltfClip final : public MotionClip {
 public:
  explicit GltfClip(GltfMotion motion) : m_(std::move(motion)) {}

  const Surface& rest() const override { return m_.rest; }
  std::size_t frame_count() const override { return m_.frames; }
  double frame_rate_hz() const override { return m_.rate_hz; }
  std::string name() const override { return m_.name; }
  std::vector<std::string> notes() const override { return m_.scene.notes; }
  const Rig* rig() const override { return &m_.scene.rig; }
  const Appearance* appearance() const override { return &m_.scene.appearance; }

  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    assert(frame < m_.frames);
    GltfPose pose = m_.scene.rest;
    m_.animation.apply(m_.animation.start_s() + static_cast<double>(frame) / m_.rate_hz, pose);
    auto positions = m_.scene.positions(pose);
    if (!positions) return in_context("frame " + std::to_string(frame) + " of " + m_.name, positions.error());
    return positions;
  }

 private:
  const GltfMotion m_;
};

void note_choice(const tinygltf::Model& model, const std::string& which, std::vector<std::string>& notes) {
  if (model.animations.size() < 2 || !which.empty()) return;
  std::string names;
  for (const tinygltf::Animation& animation : model.animations) names += (names.empty() ? "" : ", ") + animation.name;
  notes.push_back("the first of its animations (" + names + "); choose with --animation");
}

}  // namespace

Result<std::unique_ptr<MotionClip>> gltf_clip_from_bytes(std::string_view bytes, const std::string& folder,
                                                         const std::string& name, const ClipOptions& options) {
  const auto model = gltf_model_from_bytes(bytes, folder);
  if (!model) return in_context(name, model.error());
  GltfNumbers numbers(*model);
  auto scene = gltf_scene_from_model(*model, numbers);
  if (!scene) return in_context(name, scene.error());
  auto animation = GltfAnimation::from_model(*model, numbers, *scene, options.animation);
  if (!animation) return in_context(name, animation.error());
  note_choice(*model, options.animation, scene->notes);
  for (std::string& what : scene->appearance.missing) what = name + ": " + what;

  assert(options.rate_hz > 0);
  const double frames = std::floor((animation->end_s() - animation->start_s()) * options.rate_hz + 1e-6) + 1;
  if (!(frames >= 1 && frames <= static_cast<double>(kMaxClipFrames))) {
    return fail(ErrorCode::kTooLarge,
                name + ": an animation of more than " + std::to_string(kMaxClipFrames) + " frames");
  }
  auto positions = scene->positions(scene->rest);
  if (!positions) return in_context(name, positions.error());
  Surface rest{std::move(*positions), scene->faces};
  if (const auto valid = validate_surface(rest); !valid) return in_context(name, valid.error());
  return std::unique_ptr<MotionClip>(
      std::make_unique<GltfClip>(GltfMotion{std::move(*scene), std::move(*animation), std::move(rest),
                                            static_cast<std::size_t>(frames), options.rate_hz, name}));
}

Result<std::unique_ptr<MotionClip>> open_gltf_clip(const std::string& path, const ClipOptions& options) {
  const auto bytes = text::bytes_of_file(path);
  if (!bytes) return bytes.error();
  const auto folder = std::filesystem::path(path).parent_path();
  return gltf_clip_from_bytes(*bytes, folder.empty() ? "." : folder.string(), path, options);
}

}  // namespace eigencast
