// SPDX-License-Identifier: MIT
#pragma once

#include <epoxy/gl.h>

#include <algorithm>
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/core/result.h"

namespace eigencast {

/// A program for the GPU; uniforms that the driver removed are skipped. Needs its context current when destroyed.
class GlProgram final {
 public:
  struct Shaders {
    std::string vertex, geometry, fragment;  ///< Empty: none.
  };
  GlProgram() = default;
  GlProgram(const GlProgram&) = delete;
  GlProgram& operator=(const GlProgram&) = delete;
  ~GlProgram() {
    if (id_ != 0) glDeleteProgram(id_);
  }
  /// captured: outputs of the vertex shader to keep (transform feedback), packed in this order. Errors: kInternal, with
  /// the compiler's log.
  Result<void> build(const std::string& name, const Shaders& shaders, std::span<const char* const> captured = {});

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

/// Programs in which some uniforms of `fragment` are constants: each combination is built when it is first used.
/// Software renderers execute all branches that uniforms choose from. Needs its context current in every call.
class GlProgramFamily final {
 public:
  /// constants: names of ints and floats. Builds the program of zeros. Errors: as GlProgram::build.
  Result<void> init(const std::string& name, const GlProgram::Shaders& shaders, std::vector<std::string> constants);
  /// REQUIRES: init() was good; a value for each constant.
  const GlProgram& with(const std::vector<int>& values);

 private:
  Result<void> build(const std::vector<int>& values);

  std::string name_;
  GlProgram::Shaders shaders_;
  std::vector<std::string> constants_;
  std::map<std::vector<int>, GlProgram> built_;
};

/// A named OpenGL object. Needs its context current when made and when destroyed.
template <auto& kMake, auto& kRelease>
class GlName {
 public:
  GlName() { kMake(1, &id_); }
  GlName(const GlName&) = delete;
  GlName& operator=(const GlName&) = delete;
  ~GlName() { kRelease(1, &id_); }
  GLuint id() const { return id_; }

 private:
  GLuint id_ = 0;
};
using GlTexture = GlName<glGenTextures, glDeleteTextures>;
using GlArray = GlName<glGenVertexArrays, glDeleteVertexArrays>;
using GlFramebuffer = GlName<glGenFramebuffers, glDeleteFramebuffers>;

/// Binds to a texture unit, from 0 on.
void bind_texture(GLuint unit, GLenum target, GLuint texture);
/// Sets that of the bound two-dimensional texture.
void set_filter(GLint filter);
/// Copies the colours of one framebuffer to another, averaging samples.
void copy_colours(GLuint from, GLuint to, int width, int height);

/// Clamped to what the GPU can draw.
void set_line_width(float pixels);

/// Memory of the GPU.
class GlBuffer final : public GlName<glGenBuffers, glDeleteBuffers> {
 public:
  std::size_t bytes() const { return bytes_; }
  /// Loses the content where it must grow.
  void reserve(std::size_t bytes, GLenum usage);
  /// New memory: the GPU may still draw from the old.
  void renew(std::size_t bytes) { replace_bytes(nullptr, bytes); }
  template <typename T>
  void replace(std::span<const T> values) {
    replace_bytes(values.data(), values.size_bytes());
  }
  /// REQUIRES: within bytes().
  template <typename T>
  void write(std::size_t offset, std::span<const T> values) {
    write_bytes(offset, values.data(), values.size_bytes());
  }
  /// Sends the blocks of values that have changed since version `had` (0: none sent yet), to `offset`. versions: of the
  /// last change of each block; empty: unknown.
  template <typename T>
  void update(std::span<const T> values, std::span<const std::uint64_t> versions, std::size_t block_size,
              std::uint64_t had, std::size_t offset = 0) {
    const std::size_t all = offset + values.size_bytes();
    if (all > bytes()) grow(all + values.size_bytes() / 4 + sizeof(T));
    if (versions.empty() || had == 0) return write(offset, values);
    for (std::size_t first = 0, last = 0; first < versions.size(); first = last + 1) {
      for (last = first; last < versions.size() && versions[last] > had;) ++last;
      const std::size_t begin = first * block_size, end = std::min(values.size(), last * block_size);
      if (begin < end) write(offset + begin * sizeof(T), values.subspan(begin, end - begin));
    }
  }

 private:
  void grow(std::size_t bytes);  ///< Keeps the content.
  void replace_bytes(const void* data, std::size_t bytes);
  void write_bytes(std::size_t offset, const void* data, std::size_t bytes);
  std::size_t bytes_ = 0;
};

/// A framebuffer to draw to and to read back, or one of floats.
class GlPicture {
 public:
  void resize(int width, int height, GLint format = GL_RGBA8);
  GLuint framebuffer() const { return framebuffer_.id(); }
  GLuint texture() const { return colours_.id(); }
  int height() const { return height_; }

 private:
  GlTexture colours_;
  GlFramebuffer framebuffer_;
  int width_ = 0, height_ = 0;
};

/// A framebuffer of one or more samples a pixel with readable depth, and its resolved colours.
class GlTarget final {
 public:
  void resize(int width, int height, int samples);
  void bind() const { glBindFramebuffer(GL_FRAMEBUFFER, drawing_->id()); }
  void resolve() const;
  GLuint colour_texture() const { return resolved_.texture(); }
  GLuint depth_texture() const { return depth_->id(); }
  GLenum depth_kind() const { return samples_ > 1 ? GL_TEXTURE_2D_MULTISAMPLE : GL_TEXTURE_2D; }
  int samples() const { return samples_; }

 private:
  int width_ = 0, height_ = 0, asked_ = 0, samples_ = 0;
  std::optional<GlTexture> sampled_colour_, depth_;
  std::optional<GlFramebuffer> drawing_;
  GlPicture resolved_;
};

}  // namespace eigencast
