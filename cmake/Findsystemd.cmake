# SPDX-License-Identifier: MIT
# Finds libsystemd (readiness, watchdog, socket activation) through pkg-config; makes the imported target systemd::systemd.
find_package(PkgConfig QUIET REQUIRED)
pkg_check_modules(SYSTEMD QUIET IMPORTED_TARGET GLOBAL libsystemd)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(systemd REQUIRED_VARS SYSTEMD_LINK_LIBRARIES VERSION_VAR SYSTEMD_VERSION
                                  REASON_FAILURE_MESSAGE "install libsystemd-dev")
if(systemd_FOUND AND NOT TARGET systemd::systemd)
  add_library(systemd::systemd ALIAS PkgConfig::SYSTEMD)
endif()
