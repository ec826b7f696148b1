// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "view/gl_objects.h"
#include "view/paint.h"

namespace eigencast {

/// An image on the GPU, with smaller ones for what is far away. Needs its context current in every call.
class GlImage final {
 public:
  explicit GlImage(const Picture& picture);
  GLuint id() const { return texture_.id(); }

 private:
  GlTexture texture_;
};

/// What the GPU holds to draw one surface with its image: the wedges of the triangles' corners and their
/// places, of which only what changes is sent. Needs its context current in every call.
class GlTexturePaint final {
 public:
  /// REQUIRES: paint.kind == kTexture.
  void follow(const SurfacePaint& paint);
  /// For the program below. REQUIRES: follow() was called.
  void bind(const GlProgram& program) const;

 private:
  GlBuffer corners_, places_;
  GlTexture corners_texture_, places_texture_;
  std::uint64_t version_ = 0;
  bool times_values_ = false;
  const void* levels_ = nullptr;  ///< Whose versions these are, to be compared only.
  std::shared_ptr<const Picture> picture_;
  std::shared_ptr<GlImage> image_;
};

/// Draws triangles with their image: the vertex shader of meshes, a geometry shader that gives corners their places,
/// `fragment` with own_paint(). Errors: kInternal.
Result<GlProgram> textured_program(const std::string& vertex, const std::string& before_fragment,
                                   const std::string& fragment);

}  // namespace eigencast
