// SPDX-License-Identifier: MIT
#include "view/renderer.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <optional>
#include <utility>

#include "view/gl_objects.h"
#include "view/gl_surface.h"
#include "view/shaders.h"
#include "view/surroundings.h"

namespace eigencast {
namespace {

/// For the shader of meshes.
float crease_from(const DrawStyle& style) {
  return style.normals == Normals::kFlat ? -1 : style.normals == Normals::kSmooth ? 0 : style.crease_deg / 57.2957795F;
}

}  // namespace

class Renderer::Impl {
 public:
  Result<void> init() {
    const void* name = glGetString(GL_RENDERER);
    device_ = name == nullptr ? "unknown" : static_cast<const char*>(name);
    struct Source {
      GlProgram& program;
      const char* name;
      std::string vertex, fragment;
    };
    const std::string paint = std::string(shaders::kLighting) + shaders::kPaint;
    for (const Source& source :
         {Source{mesh_, "mesh", shaders::kMeshVertex, paint + shaders::kMeshPaint + shaders::kMeshFragment},
          Source{line_, "line", shaders::kMeshVertex, shaders::kLineFragment},
          Source{splat_, "splat", shaders::kSplatVertex, paint + shaders::kSplatFragment},
          Source{finish_, "finish", shaders::kScreenVertex, shaders::kFinishFragment}}) {
      const auto built = source.program.build(source.name, {source.vertex, {}, source.fragment});
      if (!built) return built;
    }
    const auto textured = build_textured(textured_, shaders::kMeshVertex, paint, shaders::kMeshFragment);
    if (!textured) return textured;
    if (const Result<void> ready = painter_.init(); !ready) return ready;
    if (const Result<void> ready = lighting_.init(); !ready) return ready;
    return surroundings_.init();
  }

  void draw(const Camera& camera, const RenderOptions& options, int width, int height, unsigned target) {
    target_.resize(width, height, kSamples);
    lighting_.cast(camera, surfaces_);
    target_.bind();
    glViewport(0, 0, width, height);
    glDisable(GL_SCISSOR_TEST);
    glClearDepth(1);
    glDepthMask(GL_TRUE);
    glClearColor(0, 0, 0, 0);
    glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
    // Alpha is coverage: colours of a transparent picture are premultiplied.
    glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
    if (!options.transparent) surroundings_.draw_wall();
    use_colour_table(options.colour_map);
    lighting_.bind();
    glEnable(GL_DEPTH_TEST);
    draw_surfaces(camera, options, height);
    const glm::mat4 clip_from_scene = camera.clip_from_view() * camera.view_from_scene();
    if (options.edges && !options.points && !options.wireframe) draw_edges(clip_from_scene, options.pixel_scale);
    const bool any = std::any_of(surfaces_.begin(), surfaces_.end(), [](const auto& s) { return s->drawable(); });
    surroundings_.draw_floor(camera, lighting_, {options.grid && !options.transparent, any, options.pixel_scale});
    if (options.axes) surroundings_.draw_axes(camera, options.pixel_scale);
    painter_.draw(markup_, clip_from_scene, width, height);
    glDisable(GL_DEPTH_TEST);
    target_.resolve();
    finish_picture(camera, target);
  }

  static constexpr int kSamples = 4;
  GlTarget target_;
  GlPicture offscreen_;
  std::string device_;
  std::vector<std::unique_ptr<GlSurface>> surfaces_;
  Markup markup_;

 private:
  void draw_surfaces(const Camera& camera, const RenderOptions& options, int height) const {
    const auto as_points = [&](const GlSurface& surface) { return surface.is_point_cloud() || options.points; };
    const auto draw_meshes = [&] {
      for (const auto& surface : surfaces_) {
        if (!surface->drawable() || as_points(*surface)) continue;
        // Edges have no image: Mesa's software renderer draws no lines after a geometry shader.
        const bool with_image = surface->texture() != nullptr && !options.wireframe;
        const GlProgram& program = with_image ? textured_ : mesh_;
        program.use();
        surface->bind(program);
        if (with_image) surface->texture()->bind(program);
        surface->draw_triangles();
      }
    };
    for (const GlProgram* program : {&mesh_, &textured_, &splat_}) {
      lighting_.light(*program, camera);
      program->set("colour_table", 1);
      program->set("crease_from", crease_from(options));
      program->set("colour_range", glm::vec2(options.colour_range[0], options.colour_range[1]));
    }
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
      set_line_width(options.pixel_scale);
      draw_meshes();
      glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
    }

    splat_.use();
    splat_.set("view_from_scene", camera.view_from_scene());
    splat_.set("clip_from_view", camera.clip_from_view());
    splat_.set("pixel_scale", options.pixel_scale);
    splat_.set("px_per_unit", 0.5F * static_cast<float>(height) / std::tan(0.5F * Camera::kFieldOfView));
    glEnable(GL_PROGRAM_POINT_SIZE);
    for (const auto& surface : surfaces_) {
      if (!surface->drawable() || !as_points(*surface)) continue;
      surface->bind(splat_);
      const float scale = surface->is_point_cloud() ? 1.15F : 0.32F;
      splat_.set("radius", scale * std::max(surface->spacing(), 1e-4F * camera.scene_radius()));
      splat_.set("discs", surface->has_discs() ? surface->scale() : 0.0F);
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

  void finish_picture(const Camera& camera, unsigned target) const {
    glBindFramebuffer(GL_FRAMEBUFFER, target);
    finish_.use();
    bind_texture(1, GL_TEXTURE_2D_MULTISAMPLE, target_.depth_texture());
    bind_texture(0, GL_TEXTURE_2D, target_.colour_texture());
    finish_.set("picture", 0);
    finish_.set("depth", 1);
    const bool all_clouds =
        !surfaces_.empty() && std::all_of(surfaces_.begin(), surfaces_.end(), [](const auto& surface) {
          return (surface->is_point_cloud() && !surface->has_discs()) || !surface->drawable();
        });
    finish_.set("dome", all_clouds ? 90.0F : 0.0F);
    const glm::mat4 clip_from_view = camera.clip_from_view();
    const float m = clip_from_view[2][2], k = clip_from_view[3][2];
    finish_.set("near_far", glm::vec2(k / (m - 1), k / (m + 1)));
    glBindVertexArray(none_.id());
    glDrawArrays(GL_TRIANGLES, 0, 3);
  }

  MarkupPainter painter_;
  Lighting lighting_;
  Surroundings surroundings_;
  GlProgram mesh_, textured_, line_, splat_, finish_;
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

unsigned Renderer::offscreen_target(int width_px, int height_px) {
  impl_->offscreen_.resize(width_px, height_px);
  return impl_->offscreen_.framebuffer();
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
