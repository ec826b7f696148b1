// SPDX-License-Identifier: MIT
#include "view/markup.h"

#include <array>
#include <cstddef>
#include <glm/geometric.hpp>

#include "view/shaders.h"

namespace eigencast {
namespace {

constexpr float kHiddenOpacity = 0.28F;
constexpr float kNearest = 1e-5F;  // clip w; points behind the camera have less

class Builder {
 public:
  Builder(std::vector<MarkCorner>& corners, const glm::mat4& clip_from_scene, int width, int height)
      : corners_(corners), clip_from_scene_(clip_from_scene), ndc_per_px_(2.0F / glm::vec2(width, height)) {}

  void line(const Markup::Line& line) {
    glm::vec4 a = clip_from_scene_ * glm::vec4(line.from, 1), b = clip_from_scene_ * glm::vec4(line.to, 1);
    if (a.w < kNearest && b.w < kNearest) return;
    if (a.w < kNearest) a = b + (a - b) * ((b.w - kNearest) / (b.w - a.w));
    if (b.w < kNearest) b = a + (b - a) * ((a.w - kNearest) / (a.w - b.w));
    flat(a, b, line.width_px, line.colour);
  }

  void dot(const Markup::Dot& dot) {
    const glm::vec4 at = clip_from_scene_ * glm::vec4(dot.at, 1);
    if (at.w < kNearest) return;
    const auto corner = [&](float x, float y) {
      return MarkCorner{moved(at, 0.5F * dot.diameter_px * glm::vec2(x, y)), dot.colour, {x, y}};
    };
    quad(corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1));
  }

  void frame(const glm::vec2& a, const glm::vec2& b) {
    const auto at = [&](float x, float y) { return glm::vec4(x * ndc_per_px_.x - 1, 1 - y * ndc_per_px_.y, -1, 1); };
    const std::array<glm::vec4, 4> ring{at(a.x, a.y), at(b.x, a.y), at(b.x, b.y), at(a.x, b.y)};
    for (std::size_t k = 0; k < 4; ++k) flat(ring[k], ring[(k + 1) % 4], 1.5F, {1, 1, 1, 0.9F});
  }

 private:
  glm::vec4 moved(const glm::vec4& clip, const glm::vec2& by_px) const {
    return clip + glm::vec4(by_px * ndc_per_px_ * clip.w, 0, 0);
  }
  void flat(const glm::vec4& a, const glm::vec4& b, float width, const glm::vec4& colour) {
    const glm::vec2 along = (glm::vec2(b) / b.w - glm::vec2(a) / a.w) / ndc_per_px_;
    const float length = glm::length(along);
    if (!(length > 0)) return;
    const glm::vec2 aside = 0.5F * width / length * glm::vec2(-along.y, along.x);
    quad({moved(a, -aside), colour}, {moved(b, -aside), colour}, {moved(b, aside), colour}, {moved(a, aside), colour});
  }
  void quad(const MarkCorner& a, const MarkCorner& b, const MarkCorner& c, const MarkCorner& d) {
    corners_.insert(corners_.end(), {a, b, c, a, c, d});
  }

  std::vector<MarkCorner>& corners_;
  const glm::mat4& clip_from_scene_;
  glm::vec2 ndc_per_px_;
};

}  // namespace

MarkTriangles triangles_from_markup(const Markup& markup, const glm::mat4& clip_from_scene, int width_px,
                                    int height_px) {
  MarkTriangles triangles;
  Builder builder(triangles.corners, clip_from_scene, width_px, height_px);
  for (const bool on_top : {false, true}) {
    if (on_top) triangles.top = triangles.corners.size();
    for (const Markup::Line& line : markup.lines) {
      if (line.on_top == on_top) builder.line(line);
    }
    for (const Markup::Dot& dot : markup.dots) {
      if (dot.on_top == on_top) builder.dot(dot);
    }
  }
  if (markup.frame) builder.frame(markup.frame->first, markup.frame->second);
  return triangles;
}

Result<void> MarkupPainter::init() {
  const auto built = program_.build("markup", {shaders::kMarkVertex, {}, shaders::kMarkFragment});
  if (!built) return built;
  glBindVertexArray(array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, corners_.id());
  const auto attribute = [](GLuint index, GLint size, std::size_t offset) {
    glVertexAttribPointer(index, size, GL_FLOAT, GL_FALSE, sizeof(MarkCorner), reinterpret_cast<const void*>(offset));
    glEnableVertexAttribArray(index);
  };
  attribute(0, 4, offsetof(MarkCorner, clip));
  attribute(1, 4, offsetof(MarkCorner, colour));
  attribute(2, 2, offsetof(MarkCorner, round));
  return {};
}

void MarkupPainter::draw(const Markup& markup, const glm::mat4& clip_from_scene, int width_px, int height_px) const {
  const MarkTriangles triangles = triangles_from_markup(markup, clip_from_scene, width_px, height_px);
  if (triangles.corners.empty()) return;
  glBindVertexArray(array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, corners_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(triangles.corners.size() * sizeof(MarkCorner)),
               triangles.corners.data(), GL_STREAM_DRAW);
  program_.use();
  glEnable(GL_BLEND);
  glBlendFunc(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA);
  glEnable(GL_DEPTH_TEST);
  glDepthMask(GL_FALSE);
  const auto pass = [&](GLenum when, float opacity, std::size_t first, std::size_t end) {
    glDepthFunc(when);
    program_.set("opacity", opacity);
    glDrawArrays(GL_TRIANGLES, static_cast<GLint>(first), static_cast<GLsizei>(end - first));
  };
  pass(GL_LEQUAL, 1, 0, triangles.top);
  pass(GL_GREATER, kHiddenOpacity, 0, triangles.top);
  pass(GL_ALWAYS, 1, triangles.top, triangles.corners.size());
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDisable(GL_BLEND);
}

}  // namespace eigencast
