// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/result.h"

namespace eigencast {

/// An OpenGL 3.3 core context without a window or a display server (EGL surfaceless), current on the thread that made
/// it until it is destroyed there.
class OffscreenContext final {
 public:
  /// Errors: kUnsupported, saying which driver package is missing.
  static Result<std::unique_ptr<OffscreenContext>> create();
  ~OffscreenContext();

 private:
  OffscreenContext() = default;
  void* display_ = nullptr;
  void* context_ = nullptr;
};

}  // namespace eigencast
