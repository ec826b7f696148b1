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

Result<void> GlProgramFamily::init(const std::string& name, const GlProgram::Shaders& shaders,
                                   std::vector<std::string> constants) {
  name_ = name;
  shaders_ = shaders;
  constants_ = std::move(constants);
  return build(std::vector<int>(constants_.size()));
}

const GlProgram& GlProgramFamily::with(const std::vector<int>& values) {
  assert(values.size() == constants_.size());
  if (const auto found = built_.find(values); found != built_.end()) return found->second;
  [[maybe_unused]] const Result<void> built = build(values);
  assert(built);
  return built_.at(values);
}

Result<void> GlProgramFamily::build(const std::vector<int>& values) {
  GlProgram::Shaders shaders = shaders_;
  for (std::size_t i = 0; i < values.size(); ++i) {
    for (const std::string type : {"int", "float"}) {
      const std::string declared = "uniform " + type + " " + constants_[i] + ";";
      if (const std::size_t at = shaders.fragment.find(declared); at != std::string::npos) {
        shaders.fragment.replace(
            at, declared.size(),
            "const " + type + " " + constants_[i] + " = " + type + "(" + std::to_string(values[i]) + ");");
      }
    }
  }
  return built_[values].build(name_, shaders);
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

void GlBuffer::grow(std::size_t bytes) {
  const GlBuffer aside;
  const auto had = static_cast<GLsizeiptr>(bytes_);
  glBindBuffer(GL_COPY_READ_BUFFER, id());
  glBindBuffer(GL_COPY_WRITE_BUFFER, aside.id());
  glBufferData(GL_COPY_WRITE_BUFFER, had, nullptr, GL_STREAM_COPY);
  if (had > 0) glCopyBufferSubData(GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, 0, 0, had);
  reserve(bytes, GL_DYNAMIC_DRAW);
  glBindBuffer(GL_COPY_READ_BUFFER, aside.id());
  if (had > 0) glCopyBufferSubData(GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, 0, 0, had);
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
  if (width == width_ && height == height_ && samples == asked_) return;
  width_ = width;
  height_ = height;
  asked_ = samples;
  // Drivers limit textures apart from renderbuffers, and refuse what asks for more.
  for (const GLenum limit : {GL_MAX_SAMPLES, GL_MAX_COLOR_TEXTURE_SAMPLES, GL_MAX_DEPTH_TEXTURE_SAMPLES}) {
    GLint here = 1;
    glGetIntegerv(limit, &here);
    samples = std::clamp(samples, 1, std::max(here, 1));
  }
  resolved_.resize(width, height);
  drawing_.emplace();
  depth_.emplace();
  bind_texture(0, samples > 1 ? GL_TEXTURE_2D_MULTISAMPLE : GL_TEXTURE_2D, depth_->id());
  if (samples > 1) {
    glTexImage2DMultisample(GL_TEXTURE_2D_MULTISAMPLE, samples, GL_DEPTH_COMPONENT24, width, height, GL_TRUE);
    sampled_colour_.emplace();
    glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, sampled_colour_->id());
    glTexImage2DMultisample(GL_TEXTURE_2D_MULTISAMPLE, samples, GL_RGBA8, width, height, GL_TRUE);
  } else {
    glTexImage2D(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT24, width, height, 0, GL_DEPTH_COMPONENT, GL_UNSIGNED_INT,
                 nullptr);
    set_filter(GL_NEAREST);
    sampled_colour_.reset();
  }
  samples_ = samples;
  bind();
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, depth_kind(),
                         sampled_colour_ ? sampled_colour_->id() : resolved_.texture(), 0);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, depth_kind(), depth_->id(), 0);
  if (samples > 1) glGetIntegerv(GL_SAMPLES, &samples_);
}

void GlTarget::resolve() const {
  if (samples_ > 1) copy_colours(drawing_->id(), resolved_.framebuffer(), width_, height_);
}

}  // namespace eigencast
