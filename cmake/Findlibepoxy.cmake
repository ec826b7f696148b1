# SPDX-License-Identifier: MIT
# Finds libepoxy (OpenGL and EGL entry points) through pkg-config; makes the imported target epoxy::epoxy.
find_package(PkgConfig QUIET REQUIRED)
pkg_check_modules(EPOXY QUIET IMPORTED_TARGET GLOBAL epoxy)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(libepoxy REQUIRED_VARS EPOXY_LINK_LIBRARIES VERSION_VAR EPOXY_VERSION
                                  REASON_FAILURE_MESSAGE "install libepoxy-dev")
if(libepoxy_FOUND AND NOT TARGET epoxy::epoxy)
  add_library(epoxy::epoxy ALIAS PkgConfig::EPOXY)
endif()
