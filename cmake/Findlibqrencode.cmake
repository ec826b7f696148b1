# SPDX-License-Identifier: MIT
# Finds libqrencode (QR codes) through pkg-config; makes the imported target libqrencode::libqrencode.
find_package(PkgConfig QUIET REQUIRED)
pkg_check_modules(LIBQRENCODE QUIET IMPORTED_TARGET GLOBAL libqrencode)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(libqrencode REQUIRED_VARS LIBQRENCODE_LINK_LIBRARIES VERSION_VAR LIBQRENCODE_VERSION
                                  REASON_FAILURE_MESSAGE "install libqrencode-dev")
if(libqrencode_FOUND AND NOT TARGET libqrencode::libqrencode)
  add_library(libqrencode::libqrencode ALIAS PkgConfig::LIBQRENCODE)
endif()
