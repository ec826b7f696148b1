# SPDX-License-Identifier: MIT
# Finds libnats (client of the NATS messaging system) through pkg-config; makes the imported target libnats::libnats.
find_package(PkgConfig QUIET REQUIRED)
pkg_check_modules(LIBNATS QUIET IMPORTED_TARGET GLOBAL libnats)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(libnats REQUIRED_VARS LIBNATS_LINK_LIBRARIES VERSION_VAR LIBNATS_VERSION
                                  REASON_FAILURE_MESSAGE "install libnats-dev")
if(libnats_FOUND AND NOT TARGET libnats::libnats)
  add_library(libnats::libnats ALIAS PkgConfig::LIBNATS)
endif()
