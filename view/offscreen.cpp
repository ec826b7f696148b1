// SPDX-License-Identifier: MIT
#include "view/renderer.h"

#include <epoxy/egl.h>

#include <array>
#include <span>

#include "common/core/text.h"

namespace eigencast {
namespace {

Error no_egl(const char* what) {
  return fail(ErrorCode::kUnsupported,
              formatted("cannot render without a display: %s failed (EGL error 0x%x); install a driver with "
                        "surfaceless EGL, such as Debian's libegl1 and libgl1-mesa-dri",
                        what, static_cast<unsigned>(eglGetError())));
}

/// The first that works: Mesa's surfaceless platform, which needs no display server; a card (NVIDIA's driver has no
/// other way); the driver's default. None of them: EGL_NO_DISPLAY.
EGLDisplay open_display() {
  const auto works = [](EGLDisplay display) {
    return display != EGL_NO_DISPLAY && eglInitialize(display, nullptr, nullptr) == EGL_TRUE;
  };
  if (epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_EXT_platform_base")) {
    if (epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_MESA_platform_surfaceless")) {
      const EGLDisplay display = eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
      if (works(display)) return display;
    }
    std::array<EGLDeviceEXT, 16> cards{};
    EGLint count = 0;
    if (epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_EXT_platform_device") &&
        epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_EXT_device_enumeration"))
      eglQueryDevicesEXT(static_cast<EGLint>(cards.size()), cards.data(), &count);
    for (const EGLDeviceEXT card : std::span(cards).first(static_cast<std::size_t>(count))) {
      const EGLDisplay display = eglGetPlatformDisplayEXT(EGL_PLATFORM_DEVICE_EXT, card, nullptr);
      if (works(display)) return display;
    }
  }
  const EGLDisplay display = eglGetDisplay(EGL_DEFAULT_DISPLAY);
  return works(display) ? display : EGL_NO_DISPLAY;
}

}  // namespace

Result<std::unique_ptr<OffscreenContext>> OffscreenContext::create() {
  std::unique_ptr<OffscreenContext> offscreen(new OffscreenContext);
  const EGLDisplay display = open_display();
  if (display == EGL_NO_DISPLAY) return no_egl("eglInitialize");
  offscreen->display_ = display;
  if (eglBindAPI(EGL_OPENGL_API) == EGL_FALSE) return no_egl("eglBindAPI");
  const std::array<EGLint, 3> wanted{EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE};
  EGLConfig config = nullptr;
  EGLint count = 0;
  if (eglChooseConfig(display, wanted.data(), &config, 1, &count) == EGL_FALSE) return no_egl("eglChooseConfig");
  const std::array<EGLint, 7> attributes{
      EGL_CONTEXT_MAJOR_VERSION,           3,       EGL_CONTEXT_MINOR_VERSION, 3, EGL_CONTEXT_OPENGL_PROFILE_MASK,
      EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE};
  const EGLContext context =
      eglCreateContext(display, count > 0 ? config : EGLConfig{}, EGL_NO_CONTEXT, attributes.data());
  if (context == EGL_NO_CONTEXT) return no_egl("eglCreateContext (OpenGL 3.3 core)");
  offscreen->context_ = context;
  if (eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context) == EGL_FALSE) return no_egl("eglMakeCurrent");
  return offscreen;
}

OffscreenContext::~OffscreenContext() {
  if (display_ == nullptr) return;
  eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
  if (context_ != nullptr) eglDestroyContext(display_, context_);
  eglTerminate(display_);
}

}  // namespace eigencast
