// SPDX-License-Identifier: MIT
#include "view/renderer.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <optional>
#include <string_view>
#include <utility>

#include "view/discs.h"
#include "view/gl_objects.h"
#include "view/gl_surface.h"
#include "view/shaders.h"
#include "view/surroundings.h"

namespace eigencast {
namespace {

/// Of the pixels drawn to those shown.
enum Scaling { kAsMany, kFewer, kMore, kScalings };
Scaling scaling_of(float scale) {
  return scale < 1 ? kFewer : scale > 1 ? kMore : kAsMany;
}

/// The last pass: of a picture of several samples or of one.
std::string finish_shader(Scaling scaling, bool single) {
  std::string shader = shaders::kFinishFragment;
  const auto replace = [&shader](std::string_view old, const std::string& by) {
    shader.replace(shader.find(old), old.size(), by);
  };
  if (scaling != kAsMany) {
    if (scaling == kFewer) replace("void main() {", std::string(shaders::kScaledUp) + "void main() {");
    replace("ivec2(gl_FragCoord.xy)", "ivec2(uv * vec2(textureSize(picture, 0)))");
    replace("texelFetch(picture, px, 0)", scaling == kFewer ? "scaled_up()" : "texture(picture, uv)");
  }
  if (single) {
    replace("sampler2DMS", "sampler2D");
    replace("textureSize(depth)", "textureSize(depth, 0)");
  }
  return shader;
}

}  // namespace

class Renderer::Impl {
 public:
  Result<void> init() {
    const void* name = glGetString(GL_RENDERER);
    device_ = name == nullptr ? "unknown" : static_cast<const char*>(name);
    const std::string paint = std::string(shaders::kLighting) + shaders::kPaint;
    const GlProgram::Shaders textured = textured_shaders(shaders::kMeshVertex, paint, shaders::kMeshFragment);
    const std::string mesh = paint + shaders::kMeshPaint + shaders::kMeshFragment;
    Result<void> built = mesh_.init("mesh", {shaders::kMeshVertex, {}, mesh}, {"paint", "shadow_saving"});
    if (built) built = textured_.init("textured mesh", textured, {"paint", "shadow_saving"});
    if (built) {
      const std::string splat = paint + shaders::kSplatFragment;
      built = splat_.init("splat", {shaders::kSplatVertex, {}, splat}, {"paint", "shadow_saving"});
    }
    if (built) built = line_.build("line", {shaders::kMeshVertex, {}, shaders::kLineFragment});
    for (const Scaling scaling : {kAsMany, kFewer, kMore}) {
      for (const bool single : {false, true}) {
        const GlProgram::Shaders finish{shaders::kScreenVertex, {}, finish_shader(scaling, single)};
        if (built) built = finish_[scaling][single].init("finish", finish, {"dome"});
      }
    }
    if (!built) return built;
    if (const Result<void> ready = discs_.init(); !ready) return ready;
    if (const Result<void> ready = painter_.init(); !ready) return ready;
    if (const Result<void> ready = lighting_.init(); !ready) return ready;
    return surroundings_.init();
  }

  void draw(const Camera& camera, const RenderOptions& options, int width, int height, unsigned target) {
    const PictureQuality& quality = options.quality;
    const float most = static_cast<float>(max_texture_side()) / static_cast<float>(std::max(width, height));
    const float scale =
        std::clamp(std::min(quality.scale, std::max(most, 1.0F)), PictureQuality::kMinScale, PictureQuality::kMaxScale);
    const auto scaled = [scale](int side) {
      return std::max(1, static_cast<int>(std::lround(scale * static_cast<float>(side))));
    };
    const int drawn_width = scaled(width), drawn_height = scaled(height);
    target_.resize(drawn_width, drawn_height, quality.samples);
    lighting_.cast(camera, surfaces_, quality.shadow);
    // Alpha is coverage: colours of a transparent picture are premultiplied.
    glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
    glDisable(GL_BLEND);
    const bool any = std::any_of(surfaces_.begin(), surfaces_.end(), [](const auto& s) { return s->drawable(); });
    Surroundings::Floor floor{options.grid && !options.transparent, any, options.pixel_scale, width, height};
    // Of the wall and the floor behind it each pixel is drawn once, whatever is before them.
    if (!options.transparent) {
      glBindFramebuffer(GL_FRAMEBUFFER, target);
      glViewport(0, 0, width, height);
      glDisable(GL_SCISSOR_TEST);
      lighting_.bind();
      surroundings_.draw_wall();
      if (quality.ground) surroundings_.draw_floor(camera, lighting_, floor);
    }
    const PixelBox part = part_with_surfaces(camera, options, drawn_width, drawn_height);
    if (part.empty()) return;
    target_.bind();
    glViewport(0, 0, drawn_width, drawn_height);
    const auto keep_to_part = [&part] {
      constexpr int kBeside = 3;  // what scaling up reads beside a part
      glEnable(GL_SCISSOR_TEST);
      glScissor(part.x - kBeside, part.y - kBeside, part.width + 2 * kBeside, part.height + 2 * kBeside);
    };
    keep_to_part();
    glClearDepth(1);
    glDepthMask(GL_TRUE);
    glClearColor(0, 0, 0, 0);
    glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
    use_colour_table(options.colour_map);
    lighting_.bind();
    glEnable(GL_DEPTH_TEST);
    const float pixel_scale = scale * options.pixel_scale;
    draw_surfaces(camera, options, drawn_width, drawn_height, pixel_scale);
    const glm::mat4 clip_from_scene = camera.clip_from_view() * camera.view_from_scene();
    if (options.edges && !options.points && !options.wireframe) draw_edges(clip_from_scene, pixel_scale);
    if (options.transparent && quality.ground) {
      floor = {false, any, pixel_scale, drawn_width, drawn_height};
      surroundings_.draw_floor(camera, lighting_, floor);
      keep_to_part();
    }
    if (options.axes) surroundings_.draw_axes(camera, pixel_scale);
    painter_.draw(markup_, clip_from_scene, drawn_width, drawn_height);
    glDisable(GL_DEPTH_TEST);
    target_.resolve();
    finish_picture(camera, options, scale, {width, height}, part, target);
  }

  GlTarget target_;
  std::array<GlPicture, 2> offscreen_;
  std::string device_;
  std::vector<std::unique_ptr<GlSurface>> surfaces_;
  Markup markup_;

 private:
  /// The variant for a surface, lit; `ready`: the one in use.
  const GlProgram& program_for(GlProgramFamily& family, const GlSurface& surface, const Camera& camera,
                               const RenderOptions& options, const GlProgram*& ready) const {
    const GlProgram& program = family.with({surface.paint_mode(), static_cast<int>(options.quality.shadow)});
    if (std::exchange(ready, &program) == &program) return program;
    lighting_.light(program, camera);
    program.set("colour_table", 1);
    program.set("by_face", options.normals == Normals::kFlat ? 1 : 0);
    program.set("colour_range", glm::vec2(options.colour_range[0], options.colour_range[1]));
    return program;
  }

  void draw_surfaces(const Camera& camera, const RenderOptions& options, int width, int height, float pixel_scale) {
    const auto as_points = [&](const GlSurface& surface) { return surface.is_point_cloud() || options.points; };
    const GlProgram* ready = nullptr;
    const auto draw_meshes = [&] {
      for (const auto& surface : surfaces_) {
        if (!surface->drawable() || as_points(*surface)) continue;
        // Edges have no image: Mesa's software renderer draws no lines after a geometry shader.
        const bool with_image = surface->texture() != nullptr && !options.wireframe;
        const GlProgram& program = program_for(with_image ? textured_ : mesh_, *surface, camera, options, ready);
        surface->bind(program);
        if (with_image) surface->texture()->bind(program);
        surface->draw_front_triangles();
      }
    };
    // Only under lines: the slope term would let back faces shine through along the silhouette.
    if (options.edges || options.wireframe) glEnable(GL_POLYGON_OFFSET_FILL);
    glPolygonOffset(1, 1);
    // A wireframe hides what is behind the surface: its faces write depth only.
    if (options.wireframe) glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
    draw_meshes();
    glDisable(GL_POLYGON_OFFSET_FILL);
    if (options.wireframe) {
      glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
      glPolygonMode(GL_FRONT_AND_BACK, GL_LINE);
      set_line_width(pixel_scale);
      draw_meshes();
      glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
    }

    glEnable(GL_PROGRAM_POINT_SIZE);
    for (const auto& surface : surfaces_) {
      if (!surface->drawable() || !as_points(*surface)) continue;
      if (surface->has_discs()) {
        const glm::vec2 range(options.colour_range[0], options.colour_range[1]);
        discs_.draw(*surface, camera, lighting_, {target_, {width, height}, pixel_scale, range});
        ready = nullptr;
        continue;
      }
      const GlProgram& program = program_for(splat_, *surface, camera, options, ready);
      program.set("view_from_scene", camera.view_from_scene());
      program.set("clip_from_view", camera.clip_from_view());
      program.set("pixel_scale", pixel_scale);
      program.set("px_per_unit", 0.5F * static_cast<float>(height) / std::tan(0.5F * Camera::kFieldOfView));
      surface->bind(program);
      const float scale = surface->is_point_cloud() ? 1.15F : 0.32F;
      program.set("radius", scale * std::max(surface->spacing(), 1e-4F * camera.scene_radius()));
      surface->draw_points();
    }
  }

  void draw_edges(const glm::mat4& clip_from_scene, float pixel_scale) const {
    line_.use();
    line_.set("clip_from_scene", clip_from_scene);
    set_line_width(pixel_scale);
    line_.set("line_colour", glm::vec4(0.08F, 0.05F, 0.07F, 0.42F));
    glEnable(GL_BLEND);
    glPolygonMode(GL_FRONT_AND_BACK, GL_LINE);
    glDepthMask(GL_FALSE);
    for (const auto& surface : surfaces_) {
      if (!surface->drawable() || surface->is_point_cloud()) continue;
      surface->bind(line_);
      surface->draw_triangles();
    }
    glDepthMask(GL_TRUE);
    glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
    glDisable(GL_BLEND);
  }

  void use_colour_table(ColourMap map) {
    bind_texture(1, GL_TEXTURE_2D, colour_table_.id());
    if (colour_map_ == map) return;
    colour_map_ = map;
    const ColourTable table = table_of(map);
    glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
    glTexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, static_cast<GLsizei>(table.size()), 1, 0, GL_RGB, GL_UNSIGNED_BYTE,
                 table.data());
    set_filter(GL_LINEAR);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  }

  /// Of the picture drawn, with room for lines and points.
  PixelBox part_with_surfaces(const Camera& camera, const RenderOptions& options, int width, int height) const {
    PixelBox part;
    const float margin = 4 + 2 * options.pixel_scale;
    const glm::mat4 clip_from_scene = camera.clip_from_view() * camera.view_from_scene();
    const PixelBox all{0, 0, width, height};
    if (options.transparent || options.axes || has_markup()) return all;
    for (const auto& surface : surfaces_) {
      if (!surface->drawable()) continue;
      const std::optional<Bounds> bounds = surface->bounds();
      if (!bounds) return all;
      part = part.with(pixels_of(bounds->corners(), clip_from_scene, width, height, margin));
    }
    return part;
  }

  bool has_markup() const { return !markup_.lines.empty() || !markup_.dots.empty() || markup_.frame; }

  void finish_picture(const Camera& camera, const RenderOptions& options, float scale, const glm::ivec2& size,
                      const PixelBox& part, unsigned target) {
    glBindFramebuffer(GL_FRAMEBUFFER, target);
    glViewport(0, 0, size.x, size.y);
    const auto shown = [scale](int side) { return static_cast<int>(std::floor(static_cast<float>(side) / scale)); };
    const int x = shown(part.x), y = shown(part.y);
    glScissor(x, y, shown(part.x + part.width) + 1 - x, shown(part.y + part.height) + 1 - y);
    if (!options.transparent) glEnable(GL_BLEND);
    const bool all_clouds =
        !surfaces_.empty() && std::all_of(surfaces_.begin(), surfaces_.end(), [](const auto& surface) {
          return (surface->is_point_cloud() && !surface->has_discs()) || !surface->drawable();
        });
    const GlProgram& finish = finish_[scaling_of(scale)][target_.samples() == 1].with({all_clouds ? 90 : 0});
    finish.use();
    bind_texture(1, target_.depth_kind(), target_.depth_texture());
    bind_texture(0, GL_TEXTURE_2D, target_.colour_texture());
    set_filter(scale != 1 ? GL_LINEAR : GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
    finish.set("picture", 0);
    finish.set("depth", 1);
    const glm::mat4 clip_from_view = camera.clip_from_view();
    const float m = clip_from_view[2][2], k = clip_from_view[3][2];
    finish.set("near_far", glm::vec2(k / (m - 1), k / (m + 1)));
    glBindVertexArray(none_.id());
    glDrawArrays(GL_TRIANGLES, 0, 3);
    glDisable(GL_BLEND);
    glDisable(GL_SCISSOR_TEST);
  }

  DiscPainter discs_;
  MarkupPainter painter_;
  Lighting lighting_;
  Surroundings surroundings_;
  GlProgramFamily mesh_, textured_, splat_;
  std::array<std::array<GlProgramFamily, 2>, kScalings> finish_;  ///< By scaling; single sample.
  GlProgram line_;
  GlArray none_;
  GlTexture colour_table_;
  std::optional<ColourMap> colour_map_;  ///< In the table.
};

Renderer::Renderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Renderer::~Renderer() = default;

Result<std::unique_ptr<Renderer>> Renderer::create() {
  if (epoxy_gl_version() < 33) {
    return fail(ErrorCode::kUnsupported,
                "the graphics driver offers OpenGL " + std::to_string(epoxy_gl_version() / 10) + "." +
                    std::to_string(epoxy_gl_version() % 10) + ", the viewer needs 3.3; try --headless");
  }
  auto impl = std::make_unique<Impl>();
  if (const Result<void> ready = impl->init(); !ready) return ready.error();
  impl->surfaces_.push_back(std::make_unique<GlSurface>());
  return std::unique_ptr<Renderer>(new Renderer(std::move(impl)));
}

void Renderer::set_surface_count(std::size_t count) {
  impl_->surfaces_.resize(std::min(count, impl_->surfaces_.size()));
  while (impl_->surfaces_.size() < count) impl_->surfaces_.push_back(std::make_unique<GlSurface>());
}

void Renderer::upload(std::size_t surface, const SurfaceGeometry& geometry) {
  assert(surface < impl_->surfaces_.size());
  impl_->surfaces_[surface]->upload(geometry);
}

void Renderer::paint(std::size_t surface, const SurfacePaint& paint) {
  assert(surface < impl_->surfaces_.size());
  impl_->surfaces_[surface]->paint(paint);
}

void Renderer::place(std::size_t surface, const glm::mat4& scene_from_surface, bool visible, float colourfulness) {
  assert(surface < impl_->surfaces_.size());
  impl_->surfaces_[surface]->place(scene_from_surface);
  impl_->surfaces_[surface]->visible = visible;
  impl_->surfaces_[surface]->colourfulness = std::clamp(colourfulness, 0.0F, 1.0F);
}

void Renderer::mark(Markup markup) {
  impl_->markup_ = std::move(markup);
}

void Renderer::draw(const Camera& camera, const RenderOptions& options, int width_px, int height_px, unsigned target) {
  if (width_px > 0 && height_px > 0) impl_->draw(camera, options, width_px, height_px, target);
}

Result<Picture> Renderer::picture(const Camera& camera, const RenderOptions& options, int width_px, int height_px) {
  GLint limit = 0;
  glGetIntegerv(GL_MAX_RENDERBUFFER_SIZE, &limit);
  if (width_px < 1 || height_px < 1 || width_px > limit || height_px > limit) {
    return fail(ErrorCode::kUnsupported, "pictures can be 1 to " + std::to_string(limit) + " pixels a side here");
  }
  const unsigned target = offscreen_target(width_px, height_px);
  draw(camera, options, width_px, height_px, target);
  return read_back(width_px, height_px, target, options.transparent);
}

Picture Renderer::read_back(int width_px, int height_px, unsigned source, bool with_alpha) {
  Picture picture;
  picture.width = width_px;
  picture.height = height_px;
  const auto width = static_cast<std::size_t>(width_px), height = static_cast<std::size_t>(height_px);
  std::vector<std::uint8_t> upside_down(4 * width * height);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, source);
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glReadPixels(0, 0, width_px, height_px, GL_RGBA, GL_UNSIGNED_BYTE, upside_down.data());
  picture.rgb.resize(3 * width * height);
  if (with_alpha) picture.alpha.resize(width * height);
  for (std::size_t y = 0; y < height; ++y) {
    for (std::size_t x = 0; x < width; ++x) {
      const std::uint8_t* from = upside_down.data() + 4 * ((height - 1 - y) * width + x);
      std::copy_n(from, 3, picture.rgb.data() + 3 * (y * width + x));
      if (with_alpha) picture.alpha[y * width + x] = from[3];
    }
  }
  return picture;
}

unsigned Renderer::offscreen_target(int width_px, int height_px, bool other) {
  GlPicture& picture = impl_->offscreen_[other ? 1 : 0];
  picture.resize(width_px, height_px);
  return picture.framebuffer();
}
void Renderer::copy_to_window(unsigned source, int width_px, int height_px) {
  copy_colours(source, 0, width_px, height_px);
}
int Renderer::max_texture_side() {
  GLint limit = 1024;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &limit);
  return limit;
}
int Renderer::samples() const {
  return impl_->target_.samples();
}
const std::string& Renderer::device() const {
  return impl_->device_;
}
void Renderer::finish() {
  glFinish();
}

}  // namespace eigencast
