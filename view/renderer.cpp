// SPDX-License-Identifier: MIT
#include "view/renderer.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstring>
#include <glm/ext/matrix_clip_space.hpp>
#include <glm/ext/matrix_transform.hpp>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <optional>
#include <utility>

#include "view/gl_objects.h"
#include "view/gl_surface.h"
#include "view/shaders.h"
#include "view/texture_paint.h"

namespace eigencast {
namespace {

constexpr int kSamples = 4;
constexpr int kShadowSide = 1024;
constexpr glm::vec3 kClay{0.70F, 0.185F, 0.115F};
constexpr glm::vec3 kClayInside{0.24F, 0.30F, 0.38F};

/// A light direction given as seen from the camera: to its right, above it, behind it.
glm::vec3 light_beside(const Camera& camera, float right, float above, float behind) {
  const glm::vec3 back = glm::normalize(camera.position() - camera.target());
  const glm::vec3 side = glm::normalize(glm::cross(camera.up_vector(), back));
  const glm::vec3 level = glm::cross(side, camera.up_vector());
  return glm::normalize(right * side + above * camera.up_vector() + behind * level);
}

glm::vec3 centre_of(const Camera& camera) {
  return 0.5F * (camera.scene_low() + camera.scene_high());
}

}  // namespace

class Renderer::Impl {
 public:
  ~Impl();
  Result<void> init();
  void draw(const Camera& camera, const RenderOptions& options, int width, int height, unsigned target);
  unsigned offscreen_target(int width, int height);

  GlTarget target_;
  std::string device_;
  std::vector<std::unique_ptr<GlSurface>> surfaces_;
  Markup markup_;

 private:
  void draw_shadow_map();
  void draw_background() const;
  void draw_ground(const Camera& camera, const RenderOptions& options) const;
  void draw_surfaces(const Camera& camera, const RenderOptions& options, int height) const;
  void draw_edges() const;
  void use_colour_table(ColourMap map);
  void draw_axes(const Camera& camera) const;
  void set_lighting(const GlProgram& program, const Camera& camera) const;
  void finish_picture(const RenderOptions& options, unsigned target) const;

  MarkupPainter painter_;
  GlProgram background_, shadow_, mesh_, textured_, line_, splat_, ground_, finish_;
  GLuint empty_array_ = 0, axes_array_ = 0, axes_ = 0;
  GLuint shadow_map_ = 0, shadow_framebuffer_ = 0, colour_table_ = 0;
  std::optional<ColourMap> colour_map_;  ///< In the table.
  GLuint offscreen_ = 0, offscreen_colour_ = 0;
  int offscreen_width_ = 0, offscreen_height_ = 0;
  glm::mat4 clip_from_scene_{1}, view_from_scene_{1}, clip_from_view_{1}, light_from_scene_{1};
  glm::vec3 key_light_{0, 1, 0}, fill_light_{0, 0, 1};
  float scene_radius_ = 1;
};

Renderer::Impl::~Impl() {
  for (GLuint array : {empty_array_, axes_array_}) glDeleteVertexArrays(1, &array);
  glDeleteBuffers(1, &axes_);
  for (GLuint texture : {shadow_map_, offscreen_colour_, colour_table_}) glDeleteTextures(1, &texture);
  for (GLuint framebuffer : {shadow_framebuffer_, offscreen_}) glDeleteFramebuffers(1, &framebuffer);
}

Result<void> Renderer::Impl::init() {
  if (epoxy_gl_version() < 33) {
    return fail(ErrorCode::kUnsupported,
                "the graphics driver offers OpenGL " + std::to_string(epoxy_gl_version() / 10) + "." +
                    std::to_string(epoxy_gl_version() % 10) + ", the viewer needs 3.3; try --headless");
  }
  const void* name = glGetString(GL_RENDERER);
  device_ = name == nullptr ? "unknown" : static_cast<const char*>(name);
  struct Source {
    GlProgram& program;
    const char* name;
    std::string vertex, fragment;
  };
  const std::string lighting = shaders::kLighting, paint = lighting + shaders::kPaint;
  for (const Source& source :
       {Source{background_, "background", shaders::kScreenVertex, shaders::kBackgroundFragment},
        Source{shadow_, "shadow", shaders::kShadowVertex, shaders::kShadowFragment},
        Source{mesh_, "mesh", shaders::kMeshVertex, paint + shaders::kMeshPaint + shaders::kMeshFragment},
        Source{line_, "line", shaders::kMeshVertex, shaders::kLineFragment},
        Source{splat_, "splat", shaders::kSplatVertex, paint + shaders::kSplatFragment},
        Source{ground_, "ground", shaders::kGroundVertex, lighting + shaders::kGroundFragment},
        Source{finish_, "finish", shaders::kScreenVertex, shaders::kFinishFragment}}) {
    Result<GlProgram> program = GlProgram::create(source.name, source.vertex, source.fragment);
    if (!program) return program.error();
    source.program = std::move(program).value();
  }
  Result<GlProgram> textured = textured_program(shaders::kMeshVertex, paint, shaders::kMeshFragment);
  if (!textured) return textured.error();
  textured_ = std::move(textured).value();
  if (const Result<void> ready = painter_.init(); !ready) return ready;
  glGenBuffers(1, &axes_);
  for (GLuint* array : {&empty_array_, &axes_array_}) glGenVertexArrays(1, array);
  glBindVertexArray(axes_array_);
  glBindBuffer(GL_ARRAY_BUFFER, axes_);
  glVertexAttribPointer(0, 3, GL_FLOAT, GL_FALSE, 0, nullptr);
  glEnableVertexAttribArray(0);

  glGenTextures(1, &shadow_map_);
  glBindTexture(GL_TEXTURE_2D, shadow_map_);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT24, kShadowSide, kShadowSide, 0, GL_DEPTH_COMPONENT, GL_FLOAT,
               nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
  glGenTextures(1, &colour_table_);
  glGenFramebuffers(1, &shadow_framebuffer_);
  glBindFramebuffer(GL_FRAMEBUFFER, shadow_framebuffer_);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, shadow_map_, 0);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  return {};
}

void Renderer::Impl::draw(const Camera& camera, const RenderOptions& options, int width, int height, unsigned target) {
  view_from_scene_ = camera.view_from_scene();
  clip_from_view_ = camera.clip_from_view();
  clip_from_scene_ = clip_from_view_ * view_from_scene_;
  scene_radius_ = camera.scene_radius();
  key_light_ = light_beside(camera, -0.62F, 1.15F, 0.62F);
  fill_light_ = light_beside(camera, 0.9F, 0.15F, 0.45F);
  const glm::vec3 centre = centre_of(camera);
  const float reach = 2.2F * scene_radius_;  // a deforming surface leaves its rest box
  const glm::vec3 beside = std::abs(glm::dot(key_light_, camera.up_vector())) > 0.99F
                               ? glm::vec3(camera.up_vector().y, camera.up_vector().z, camera.up_vector().x)
                               : camera.up_vector();
  light_from_scene_ = glm::ortho(-reach, reach, -reach, reach, 0.0F, 4 * reach) *
                      glm::lookAt(centre + 2 * reach * key_light_, centre, beside);

  target_.resize(width, height, kSamples);
  draw_shadow_map();
  target_.bind();
  glViewport(0, 0, width, height);
  glDisable(GL_SCISSOR_TEST);
  glClearDepth(1);
  glDepthMask(GL_TRUE);
  glClearColor(0, 0, 0, 0);
  glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
  // Alpha as coverage: over a transparent picture the colours come out multiplied by it.
  glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  if (!options.transparent) draw_background();
  use_colour_table(options.colour_map);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, shadow_map_);
  glEnable(GL_DEPTH_TEST);
  draw_surfaces(camera, options, height);
  if (options.edges && !options.points && !options.wireframe) draw_edges();
  draw_ground(camera, options);
  if (options.axes) draw_axes(camera);
  painter_.draw(markup_, clip_from_scene_, width, height);
  glDisable(GL_DEPTH_TEST);
  target_.resolve();
  finish_picture(options, target);
}

void Renderer::Impl::draw_shadow_map() {
  glBindFramebuffer(GL_FRAMEBUFFER, shadow_framebuffer_);
  glViewport(0, 0, kShadowSide, kShadowSide);
  glDepthMask(GL_TRUE);
  glClear(GL_DEPTH_BUFFER_BIT);
  glEnable(GL_DEPTH_TEST);
  glEnable(GL_PROGRAM_POINT_SIZE);
  shadow_.use();
  shadow_.set("light_from_scene", light_from_scene_);
  for (const auto& surface : surfaces_) {
    if (!surface->drawable()) continue;
    surface->bind(shadow_);
    if (surface->is_point_cloud()) {
      shadow_.set("point_px", std::max(1.0F, 2 * surface->spacing() * kShadowSide / (4.4F * scene_radius_)));
      surface->draw_points();
    } else {
      surface->draw_triangles();
    }
  }
}

void Renderer::Impl::use_colour_table(ColourMap map) {
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, colour_table_);
  if (colour_map_ == map) return;
  colour_map_ = map;
  const ColourTable table = table_of(map);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, static_cast<GLsizei>(table.size()), 1, 0, GL_RGB, GL_UNSIGNED_BYTE,
               table.data());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
}

void Renderer::Impl::draw_background() const {
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_BLEND);
  background_.use();
  glBindVertexArray(empty_array_);
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

void Renderer::Impl::set_lighting(const GlProgram& program, const Camera& camera) const {
  program.use();
  program.set("shadow_map", 0);
  program.set("light_from_scene", light_from_scene_);
  program.set("shadow_blur", 0.006F);
  program.set("clip_from_scene", clip_from_scene_);
  program.set("eye", camera.position());
  program.set("up", camera.up_vector());
  program.set("key_light", key_light_);
  program.set("fill_light", fill_light_);
  program.set("albedo", kClay);
  program.set("albedo_inside", kClayInside);
  program.set("normal_offset", 0.018F * scene_radius_);
}

void Renderer::Impl::draw_surfaces(const Camera& camera, const RenderOptions& options, int height) const {
  const auto as_points = [&](const GlSurface& surface) { return surface.is_point_cloud() || options.points; };
  const auto draw_meshes = [&] {
    for (const auto& surface : surfaces_) {
      if (!surface->drawable() || as_points(*surface)) continue;
      // Edges have no image: Mesa's software renderer does not draw the lines of what a geometry shader has made.
      const bool with_image = surface->texture() != nullptr && !options.wireframe;
      const GlProgram& program = with_image ? textured_ : mesh_;
      program.use();
      surface->bind(program);
      if (with_image) surface->texture()->bind(program);
      surface->draw_triangles();
    }
  };
  for (const GlProgram* program : {&mesh_, &textured_}) {
    set_lighting(*program, camera);
    program->set("colour_table", 1);
    program->set("colour_range", glm::vec2(options.colour_range[0], options.colour_range[1]));
  }
  // Only under lines: the slope term would let back faces shine through along the silhouette.
  if (options.edges || options.wireframe) glEnable(GL_POLYGON_OFFSET_FILL);
  glPolygonOffset(1, 1);
  // A wireframe hides what is behind the surface: its faces leave their depth and nothing else.
  if (options.wireframe) glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  draw_meshes();
  glDisable(GL_POLYGON_OFFSET_FILL);
  if (options.wireframe) {
    glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    glPolygonMode(GL_FRONT_AND_BACK, GL_LINE);
    draw_meshes();
    glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
  }

  set_lighting(splat_, camera);
  splat_.set("colour_table", 1);
  splat_.set("colour_range", glm::vec2(options.colour_range[0], options.colour_range[1]));
  splat_.set("view_from_scene", view_from_scene_);
  splat_.set("clip_from_view", clip_from_view_);
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

void Renderer::Impl::draw_edges() const {
  line_.use();
  line_.set("clip_from_scene", clip_from_scene_);
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

void Renderer::Impl::draw_ground(const Camera& camera, const RenderOptions& options) const {
  const glm::vec3 up = camera.up_vector();
  const float floor_level = glm::dot(camera.scene_low(), up) - 0.02F * scene_radius_;
  if (glm::dot(camera.position(), up) <= floor_level) return;  // seen from below it would hide the surface
  const glm::vec3 a = glm::vec3(up.y, up.z, up.x), b = glm::cross(up, a);
  const glm::vec3 centre = centre_of(camera);
  const float reach = 4 * scene_radius_;
  set_lighting(ground_, camera);
  ground_.set("ground_centre", centre + (floor_level - glm::dot(centre, up)) * up);
  ground_.set("ground_a", reach * a);
  ground_.set("ground_b", reach * b);
  ground_.set("grid_cells", 20.0F);
  ground_.set("grid_strength", options.grid ? 1.0F : 0.0F);
  const glm::vec3 extent = camera.scene_high() - camera.scene_low();
  const bool any = std::any_of(surfaces_.begin(), surfaces_.end(), [](const auto& s) { return s->drawable(); });
  const float across = std::max(glm::length(extent - glm::dot(extent, up) * up), 0.2F * scene_radius_);
  ground_.set("contact_radius", any ? 0.5F * across / reach : 1e-4F);
  ground_.set("shadow_blur", 0.012F);
  glEnable(GL_BLEND);
  glDepthMask(GL_FALSE);
  glBindVertexArray(empty_array_);
  glDrawArrays(GL_TRIANGLE_STRIP, 0, 4);
  glDepthMask(GL_TRUE);
  glDisable(GL_BLEND);
}

void Renderer::Impl::draw_axes(const Camera& camera) const {
  const glm::vec3 from = centre_of(camera);
  line_.use();
  line_.set("clip_from_scene", clip_from_scene_);
  line_.set("scene_from_surface", glm::mat4(1));
  glBindVertexArray(axes_array_);
  glDisable(GL_DEPTH_TEST);
  for (int axis = 0; axis < 3; ++axis) {
    glm::vec3 to = from;
    to[axis] += 1.15F * scene_radius_;
    const std::array<glm::vec3, 2> ends{from, to};
    glBindBuffer(GL_ARRAY_BUFFER, axes_);
    glBufferData(GL_ARRAY_BUFFER, sizeof ends, ends.data(), GL_STREAM_DRAW);
    glm::vec4 colour(0.15F, 0.15F, 0.15F, 1);
    colour[axis] = 0.8F;
    line_.set("line_colour", colour);
    glDrawArrays(GL_LINES, 0, 2);
  }
}

void Renderer::Impl::finish_picture(const RenderOptions& options, unsigned target) const {
  glBindFramebuffer(GL_FRAMEBUFFER, target);
  finish_.use();
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, target_.depth_texture());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target_.colour_texture());
  finish_.set("picture", 0);
  finish_.set("depth", 1);
  finish_.set("colourfulness", std::clamp(options.colourfulness, 0.0F, 1.0F));
  const bool all_clouds =
      !surfaces_.empty() && std::all_of(surfaces_.begin(), surfaces_.end(), [](const auto& surface) {
        return (surface->is_point_cloud() && !surface->has_discs()) || !surface->drawable();
      });
  finish_.set("dome", all_clouds ? 90.0F : 0.0F);
  const float m = clip_from_view_[2][2], k = clip_from_view_[3][2];
  finish_.set("near_far", glm::vec2(k / (m - 1), k / (m + 1)));
  glBindVertexArray(empty_array_);
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

unsigned Renderer::Impl::offscreen_target(int width, int height) {
  if (offscreen_ != 0 && width == offscreen_width_ && height == offscreen_height_) return offscreen_;
  if (offscreen_ == 0) {
    glGenFramebuffers(1, &offscreen_);
    glGenTextures(1, &offscreen_colour_);
  }
  offscreen_width_ = width;
  offscreen_height_ = height;
  glBindTexture(GL_TEXTURE_2D, offscreen_colour_);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, width, height, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, offscreen_);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, offscreen_colour_, 0);
  return offscreen_;
}

Renderer::Renderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Renderer::~Renderer() = default;

Result<std::unique_ptr<Renderer>> Renderer::create() {
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

void Renderer::place(std::size_t surface, const glm::mat4& scene_from_surface, bool visible) {
  assert(surface < impl_->surfaces_.size());
  impl_->surfaces_[surface]->place(scene_from_surface);
  impl_->surfaces_[surface]->visible = visible;
}

void Renderer::mark(Markup markup) {
  impl_->markup_ = std::move(markup);
}

void Renderer::draw(const Camera& camera, const RenderOptions& options, int width_px, int height_px, unsigned target) {
  if (width_px > 0 && height_px > 0) impl_->draw(camera, options, width_px, height_px, target);
}

Result<Picture> Renderer::picture(const Camera& camera, const RenderOptions& options, int width_px, int height_px) {
  GLint most = 0;
  glGetIntegerv(GL_MAX_RENDERBUFFER_SIZE, &most);
  if (width_px < 1 || height_px < 1 || width_px > most || height_px > most) {
    return fail(ErrorCode::kUnsupported, "pictures can be 1 to " + std::to_string(most) + " pixels a side here");
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
  return impl_->offscreen_target(width_px, height_px);
}
void Renderer::copy_to_window(unsigned source, int width_px, int height_px) {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, source);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, 0);
  glBlitFramebuffer(0, 0, width_px, height_px, 0, 0, width_px, height_px, GL_COLOR_BUFFER_BIT, GL_NEAREST);
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
