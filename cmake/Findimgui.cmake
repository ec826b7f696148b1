# SPDX-License-Identifier: MIT
# Finds Dear ImGui with its GLFW and OpenGL 3 back ends through pkg-config; makes the imported target imgui::imgui.
find_package(PkgConfig QUIET REQUIRED)
pkg_check_modules(IMGUI QUIET IMPORTED_TARGET GLOBAL imgui)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(imgui REQUIRED_VARS IMGUI_LINK_LIBRARIES VERSION_VAR IMGUI_VERSION
                                  REASON_FAILURE_MESSAGE "install libimgui-dev")
if(imgui_FOUND AND NOT TARGET imgui::imgui)
  add_library(imgui::imgui ALIAS PkgConfig::IMGUI)
endif()
