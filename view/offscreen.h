// SPDX-License-Identifier: MIT
#pragma once

#include <memory>

#include "common/core/result.h"

namespace eigencast {

/// An OpenGL 3.3 core context without window and display server (EGL surfaceless), current on the thread that creates
/// and destroys it.
class OffscreenContext final {
 public:
  /// Errors: kUnsupported, naming the missing driver package.
  static Result<std::unique_ptr<OffscreenContext>> create();
  ~OffscreenContext();

 private:
  OffscreenContext() = default;
  void* display_ = nullptr;
  void* context_ = nullptr;
};

}  // namespace eigencast
