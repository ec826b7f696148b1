// SPDX-License-Identifier: MIT
#include "view/gl_objects.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <utility>

namespace eigencast {
namespace {

Result<GLuint> compile(GLenum kind, const std::string& name, const std::string& source) {
  const GLuint shader = glCreateShader(kind);
  const char* text = source.c_str();
  glShaderSource(shader, 1, &text, nullptr);
  glCompileShader(shader);
  GLint good = GL_FALSE;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &good);
  if (good == GL_TRUE) return shader;
  std::array<char, 2048> log{};
  glGetShaderInfoLog(shader, static_cast<GLsizei>(log.size()), nullptr, log.data());
  glDeleteShader(shader);
  return fail(ErrorCode::kInternal, "shader " + name + " does not compile: " + log.data());
}

}  // namespace

Result<void> GlProgram::build(const std::string& name, const Shaders& shaders, std::span<const char* const> captured) {
  id_ = glCreateProgram();
  for (const auto& [kind, source] :
       {std::pair(GL_VERTEX_SHADER, shaders.vertex), std::pair(GL_GEOMETRY_SHADER, shaders.geometry),
        std::pair(GL_FRAGMENT_SHADER, shaders.fragment)}) {
    if (source.empty()) continue;
    const Result<GLuint> shader = compile(static_cast<GLenum>(kind), name, source);
    if (!shader) return shader.error();
    glAttachShader(id_, *shader);
    glDeleteShader(*shader);  // with the program
  }
  if (!captured.empty())
    glTransformFeedbackVaryings(id_, static_cast<GLsizei>(captured.size()), captured.data(), GL_INTERLEAVED_ATTRIBS);
  glLinkProgram(id_);
  GLint good = GL_FALSE;
  glGetProgramiv(id_, GL_LINK_STATUS, &good);
  if (good == GL_TRUE) return {};
  std::array<char, 2048> log{};
  glGetProgramInfoLog(id_, static_cast<GLsizei>(log.size()), nullptr, log.data());
  return fail(ErrorCode::kInternal, "shader " + name + " does not link: " + log.data());
}

void bind_texture(GLuint unit, GLenum target, GLuint texture) {
  glActiveTexture(GL_TEXTURE0 + unit);
  glBindTexture(target, texture);
}

void set_filter(GLint filter) {
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, filter);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, filter);
}

void copy_colours(GLuint from, GLuint to, int width, int height) {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, from);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, to);
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_COLOR_BUFFER_BIT, GL_NEAREST);
}

void set_line_width(float pixels) {
  std::array<GLfloat, 2> range{1, 1};
  glGetFloatv(GL_ALIASED_LINE_WIDTH_RANGE, range.data());
  glLineWidth(std::clamp(pixels, range[0], range[1]));
}

// Through a target that no array remembers.
void GlBuffer::reserve(std::size_t bytes, GLenum usage) {
  if (bytes <= bytes_) return;
  bytes_ = bytes;
  glBindBuffer(GL_COPY_WRITE_BUFFER, id());
  glBufferData(GL_COPY_WRITE_BUFFER, static_cast<GLsizeiptr>(bytes), nullptr, usage);
}

void GlBuffer::replace_bytes(const void* data, std::size_t bytes) {
  bytes_ = bytes;
  glBindBuffer(GL_COPY_WRITE_BUFFER, id());
  glBufferData(GL_COPY_WRITE_BUFFER, static_cast<GLsizeiptr>(bytes), data, GL_STREAM_DRAW);
}

void GlBuffer::write_bytes(std::size_t offset, const void* data, std::size_t bytes) {
  assert(offset + bytes <= bytes_);
  glBindBuffer(GL_COPY_WRITE_BUFFER, id());
  glBufferSubData(GL_COPY_WRITE_BUFFER, static_cast<GLintptr>(offset), static_cast<GLsizeiptr>(bytes), data);
}

void GlPicture::resize(int width, int height, GLint format) {
  if (width == width_ && height == height_) return;
  width_ = width;
  height_ = height;
  bind_texture(0, GL_TEXTURE_2D, texture());
  glTexImage2D(GL_TEXTURE_2D, 0, format, width, height, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  set_filter(GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, texture(), 0);
}

void GlTarget::resize(int width, int height, int samples) {
  if (width == width_ && height == height_) return;
  width_ = width;
  height_ = height;
  // Drivers limit textures apart from renderbuffers, and refuse what asks for more.
  for (const GLenum limit : {GL_MAX_SAMPLES, GL_MAX_COLOR_TEXTURE_SAMPLES, GL_MAX_DEPTH_TEXTURE_SAMPLES}) {
    GLint here = 1;
    glGetIntegerv(limit, &here);
    samples = std::clamp(samples, 1, std::max(here, 1));
  }
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, sampled_colour_.id());
  glTexImage2DMultisample(GL_TEXTURE_2D_MULTISAMPLE, samples, GL_RGBA8, width, height, GL_TRUE);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, depth_.id());
  glTexImage2DMultisample(GL_TEXTURE_2D_MULTISAMPLE, samples, GL_DEPTH_COMPONENT24, width, height, GL_TRUE);
  bind();
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D_MULTISAMPLE, sampled_colour_.id(), 0);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D_MULTISAMPLE, depth_.id(), 0);
  glGetIntegerv(GL_SAMPLES, &samples_);
  resolved_.resize(width, height);
}

}  // namespace eigencast
