// SPDX-License-Identifier: MIT
#pragma once

#include <epoxy/gl.h>

#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <span>
#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast {

/// A linked program; uniforms that the driver removed are skipped. Owned; needs its context current when destroyed.
class GlProgram final {
 public:
  GlProgram() = default;
  /// captured: what the vertex shader says of each vertex, packed one after the other, where it is to be kept (transform
  /// feedback). No fragment shader: nothing is drawn. Errors: kInternal, with the compiler's log.
  static Result<GlProgram> create(const std::string& name, const std::string& vertex, const std::string& fragment,
                                  std::span<const char* const> captured = {}) {
    return create(name, Shaders{vertex, {}, fragment}, captured);
  }
  struct Shaders {
    std::string vertex, geometry, fragment;  ///< Empty: none.
  };
  static Result<GlProgram> create(const std::string& name, const Shaders& shaders,
                                  std::span<const char* const> captured = {});
  GlProgram(GlProgram&& other) noexcept : id_(other.id_) { other.id_ = 0; }
  GlProgram& operator=(GlProgram&& other) noexcept;
  ~GlProgram();

  void use() const { glUseProgram(id_); }
  void set(const char* name, float value) const { glUniform1f(at(name), value); }
  void set(const char* name, int value) const { glUniform1i(at(name), value); }
  void set(const char* name, const glm::vec2& value) const { glUniform2fv(at(name), 1, &value[0]); }
  void set(const char* name, const glm::vec3& value) const { glUniform3fv(at(name), 1, &value[0]); }
  void set(const char* name, const glm::vec4& value) const { glUniform4fv(at(name), 1, &value[0]); }
  void set(const char* name, const glm::mat3& value) const { glUniformMatrix3fv(at(name), 1, GL_FALSE, &value[0][0]); }
  void set(const char* name, const glm::mat4& value) const { glUniformMatrix4fv(at(name), 1, GL_FALSE, &value[0][0]); }

 private:
  GLint at(const char* name) const { return glGetUniformLocation(id_, name); }
  GLuint id_ = 0;
};

/// Memory of the graphics card. Owned; needs its context current when destroyed.
class GlBuffer final {
 public:
  GlBuffer() { glGenBuffers(1, &id_); }
  GlBuffer(const GlBuffer&) = delete;
  GlBuffer& operator=(const GlBuffer&) = delete;
  ~GlBuffer() { glDeleteBuffers(1, &id_); }

  GLuint id() const { return id_; }
  std::size_t bytes() const { return bytes_; }
  /// Makes room for at least so many bytes; what was in it is lost where it must grow.
  void reserve(std::size_t bytes, GLenum usage);
  /// All of it anew, for one picture.
  template <typename T>
  void replace(std::span<const T> values) {
    replace_bytes(values.data(), values.size_bytes());
  }
  /// REQUIRES: within bytes().
  template <typename T>
  void write(std::size_t offset, std::span<const T> values) {
    write_bytes(offset, values.data(), values.size_bytes());
  }

 private:
  void replace_bytes(const void* data, std::size_t bytes);
  void write_bytes(std::size_t offset, const void* data, std::size_t bytes);
  GLuint id_ = 0;
  std::size_t bytes_ = 0;
};

/// Framebuffers of one size: a multisampled one to draw to with a depth that can be read, and its resolved colours.
class GlTarget final {
 public:
  GlTarget() = default;
  GlTarget(const GlTarget&) = delete;
  GlTarget& operator=(const GlTarget&) = delete;
  ~GlTarget() { release(); }

  /// Makes it width x height with up to `samples` a pixel; nothing happens if it is so already.
  void resize(int width, int height, int samples);
  void bind() const { glBindFramebuffer(GL_FRAMEBUFFER, drawing_); }
  /// Averages the samples into colour_texture().
  void resolve() const;
  GLuint colour_texture() const { return colour_; }
  GLuint depth_texture() const { return depth_; }
  int samples() const { return samples_; }

 private:
  void release();
  int width_ = 0, height_ = 0, samples_ = 0;
  GLuint drawing_ = 0, sampled_colour_ = 0, depth_ = 0, resolved_ = 0, colour_ = 0;
};

}  // namespace eigencast
