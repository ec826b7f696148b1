// SPDX-License-Identifier: MIT
#pragma once

#include <memory>
#include <string>

#include "view/gl_objects.h"
#include "view/paint.h"

namespace eigencast {

class GlImage final {
 public:
  explicit GlImage(const Picture& picture);
  GLuint id() const { return texture_.id(); }

 private:
  GlTexture texture_;
};

/// A surface's wedges and UVs on the GPU. Sends only blocks that have changed. Needs its context current in every call.
class GlTexturePaint final {
 public:
  /// REQUIRES: paint.kind == kTexture.
  void follow(const SurfacePaint& paint);
  /// REQUIRES: follow() was called; a program of build_textured().
  void bind(const GlProgram& program) const;

 private:
  GlBuffer corners_, uvs_;
  GlTexture corners_texture_, uvs_texture_;
  std::uint64_t version_ = 0;
  bool times_values_ = false;
  const void* levels_ = nullptr;  ///< Owner of version_, for comparison only.
  std::shared_ptr<const Picture> picture_;
  std::shared_ptr<GlImage> image_;
};

/// The vertex shader of meshes, a geometry shader that gives corners their UVs, `fragment` with own_paint().
Result<void> build_textured(GlProgram& program, const std::string& vertex, const std::string& before_fragment,
                            const std::string& fragment);

}  // namespace eigencast
