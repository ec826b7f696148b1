// SPDX-License-Identifier: MIT
#include "view/discs.h"

#include <array>
#include <cmath>
#include <string>
#include <utility>

#include "view/shaders.h"

namespace eigencast {
namespace {

constexpr GLuint kSeenUnit = 2, kFacingUnit = 3, kBaseUnit = 4, kOutsideUnit = 6;
/// Of discs' radii: what hides others, and where the kernel is zero, so that neighbours overlap.
constexpr float kSeenReach = 0.9F, kSumReach = 1.3F;

}  // namespace

Result<void> DiscPainter::init() {
  const std::string version = "#version 330 core\n", light = std::string(shaders::kLighting) + shaders::kPaint;
  const std::string disc = version + shaders::kDiscFragment;
  auto built =
      seen_.build("what is seen of discs",
                  {version + shaders::kDiscVertex + shaders::kDiscSeenVertex, {}, disc + shaders::kDiscSeenFragment});
  if (built) {
    built = sum_.build("sum of discs", {light + shaders::kDiscVertex + shaders::kDiscSumVertex,
                                        {},
                                        disc + shaders::kDiscDistance + shaders::kDiscSumFragment});
  }
  if (built) {
    built =
        shade_.init("discs", {shaders::kScreenVertex, {}, light + shaders::kDiscDistance + shaders::kDiscShadeFragment},
                    {"paint", "shadow_saving"});
  }
  return built;
}

void DiscPainter::resize(const glm::ivec2& size) {
  if (std::exchange(size_, size) == size) return;
  const auto make = [&](const GlTexture& texture, GLint inside, GLenum format, GLenum type, GLenum attachment) {
    bind_texture(kSeenUnit, GL_TEXTURE_2D, texture.id());
    glTexImage2D(GL_TEXTURE_2D, 0, inside, size.x, size.y, 0, format, type, nullptr);
    set_filter(GL_NEAREST);
    glFramebufferTexture2D(GL_FRAMEBUFFER, attachment, GL_TEXTURE_2D, texture.id(), 0);
  };
  glBindFramebuffer(GL_FRAMEBUFFER, seen_framebuffer_.id());
  make(depth_, GL_DEPTH_COMPONENT24, GL_DEPTH_COMPONENT, GL_UNSIGNED_INT, GL_DEPTH_ATTACHMENT);
  make(outside_, GL_R8, GL_RED, GL_UNSIGNED_BYTE, GL_COLOR_ATTACHMENT0);
  glBindFramebuffer(GL_FRAMEBUFFER, sum_framebuffer_.id());
  make(facing_, GL_RGBA16F, GL_RGBA, GL_FLOAT, GL_COLOR_ATTACHMENT0);
  make(base_, GL_RGBA16F, GL_RGBA, GL_FLOAT, GL_COLOR_ATTACHMENT1);
  constexpr std::array<GLenum, 2> kBoth{GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1};
  glDrawBuffers(2, kBoth.data());
}

void DiscPainter::place(const GlProgram& program, const GlSurface& surface, const Camera& camera,
                        const Target& target) const {
  program.set("view_from_scene", camera.view_from_scene());
  program.set("clip_from_view", camera.clip_from_view());
  program.set("pixel_scale", target.pixel_scale);
  program.set("px_per_unit", 0.5F * static_cast<float>(target.size.y) / std::tan(0.5F * Camera::kFieldOfView));
  program.set("discs", surface.scale());
  program.set("reach", &program == &seen_ ? kSeenReach : kSumReach);
  surface.bind(program);
}

void DiscPainter::draw(const GlSurface& surface, const Camera& camera, const Lighting& lighting, const Target& target) {
  resize(target.size);
  const glm::mat4 clip_from_view = camera.clip_from_view();
  const float m = clip_from_view[2][2], k = clip_from_view[3][2];
  const auto see = [&](const GlProgram& program) {
    program.set("seen", static_cast<int>(kSeenUnit));
    program.set("outside", static_cast<int>(kOutsideUnit));
    program.set("near_far", glm::vec2(k / (m - 1), k / (m + 1)));
  };
  glEnable(GL_PROGRAM_POINT_SIZE);
  glBindFramebuffer(GL_FRAMEBUFFER, seen_framebuffer_.id());
  glClear(GL_DEPTH_BUFFER_BIT | GL_COLOR_BUFFER_BIT);
  seen_.use();
  place(seen_, surface, camera, target);
  surface.draw_points();

  glBindFramebuffer(GL_FRAMEBUFFER, sum_framebuffer_.id());
  glClear(GL_COLOR_BUFFER_BIT);
  bind_texture(kSeenUnit, GL_TEXTURE_2D, depth_.id());
  bind_texture(kOutsideUnit, GL_TEXTURE_2D, outside_.id());
  glDisable(GL_DEPTH_TEST);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ONE, GL_ONE);
  lighting.light(sum_, camera);
  sum_.set("colour_table", 1);
  sum_.set("colour_range", target.colour_range);
  sum_.set("paint", surface.paint_mode());
  sum_.set("shadow_saving", static_cast<int>(lighting.quality()));
  see(sum_);
  place(sum_, surface, camera, target);
  surface.draw_points();

  target.picture.bind();
  glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  glEnable(GL_DEPTH_TEST);
  bind_texture(kFacingUnit, GL_TEXTURE_2D, facing_.id());
  bind_texture(kBaseUnit, GL_TEXTURE_2D, base_.id());
  glActiveTexture(GL_TEXTURE0);
  const GlProgram& shade = shade_.with({surface.paint_mode(), static_cast<int>(lighting.quality())});
  lighting.light(shade, camera);
  see(shade);
  shade.set("facing_sum", static_cast<int>(kFacingUnit));
  shade.set("base_sum", static_cast<int>(kBaseUnit));
  shade.set("view_from_scene", camera.view_from_scene());
  shade.set("ray", glm::vec2(1 / clip_from_view[0][0], 1 / clip_from_view[1][1]));
  shade.set("colourfulness", surface.colourfulness);
  glBindVertexArray(none_.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glDisable(GL_BLEND);
}

}  // namespace eigencast
