# SPDX-License-Identifier: MIT
# Finds liburing (batches of system calls) through pkg-config; makes the imported target liburing::liburing.
find_package(PkgConfig QUIET REQUIRED)
pkg_check_modules(LIBURING QUIET IMPORTED_TARGET GLOBAL liburing)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(liburing REQUIRED_VARS LIBURING_LINK_LIBRARIES VERSION_VAR LIBURING_VERSION
                                  REASON_FAILURE_MESSAGE "install liburing-dev")
if(liburing_FOUND AND NOT TARGET liburing::liburing)
  add_library(liburing::liburing ALIAS PkgConfig::LIBURING)
endif()
