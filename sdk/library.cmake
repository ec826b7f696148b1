# SPDX-License-Identifier: MIT
# libeigencast: one shared library whose only symbols are those of <eigencast/eigencast.h>; the rooms are linked into it.
include(CMakePackageConfigHelpers)

add_library(eigencast SHARED abi.cpp abi_mesh.cpp abi_publisher.cpp abi_stream.cpp abi_subscriber.cpp)
add_library(eigencast::eigencast ALIAS eigencast)
target_include_directories(eigencast PUBLIC
  "$<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>" "$<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>")
target_compile_definitions(eigencast PRIVATE EIGENCAST_VERSION="${PROJECT_VERSION}")
target_link_libraries(eigencast PRIVATE $<BUILD_INTERFACE:eigencast_flags> $<BUILD_INTERFACE:eigencast_sdk>)
eigencast_use_precompiled(eigencast eigencast_headers)
# The static rooms bring symbols of header-only libraries along; the version script keeps all of them inside.
target_link_options(eigencast PRIVATE "-Wl,--version-script=${CMAKE_CURRENT_SOURCE_DIR}/eigencast.map")
set_target_properties(eigencast PROPERTIES
  LINK_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/eigencast.map"
  VERSION "${PROJECT_VERSION}" SOVERSION 0 CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON
  LIBRARY_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/lib")

install(TARGETS eigencast EXPORT eigencast-targets
  LIBRARY DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT library NAMELINK_COMPONENT development)
install(DIRECTORY include/eigencast DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" COMPONENT development
  FILES_MATCHING PATTERN "*.h" PATTERN "*.hpp")
install(DIRECTORY python/eigencast DESTINATION lib/python3/dist-packages COMPONENT python FILES_MATCHING PATTERN "*.py")
install(EXPORT eigencast-targets NAMESPACE eigencast:: DESTINATION "${CMAKE_INSTALL_LIBDIR}/cmake/eigencast"
  COMPONENT development)
configure_package_config_file("${PROJECT_SOURCE_DIR}/cmake/eigencast-config.cmake.in"
  "${CMAKE_CURRENT_BINARY_DIR}/eigencast-config.cmake" INSTALL_DESTINATION "${CMAKE_INSTALL_LIBDIR}/cmake/eigencast")
write_basic_package_version_file("${CMAKE_CURRENT_BINARY_DIR}/eigencast-config-version.cmake" COMPATIBILITY SameMinorVersion)
# Relative to the .pc file, so that the tree can be moved. LIBDIR may have one part (lib) or two (lib/x86_64-linux-gnu).
file(RELATIVE_PATH EIGENCAST_PREFIX_FROM_PC "/prefix/${CMAKE_INSTALL_LIBDIR}/pkgconfig" "/prefix")
configure_file("${PROJECT_SOURCE_DIR}/cmake/eigencast.pc.in" "${CMAKE_CURRENT_BINARY_DIR}/eigencast.pc" @ONLY)
install(FILES "${CMAKE_CURRENT_BINARY_DIR}/eigencast-config.cmake" "${CMAKE_CURRENT_BINARY_DIR}/eigencast-config-version.cmake"
  DESTINATION "${CMAKE_INSTALL_LIBDIR}/cmake/eigencast" COMPONENT development)
install(FILES "${CMAKE_CURRENT_BINARY_DIR}/eigencast.pc" DESTINATION "${CMAKE_INSTALL_LIBDIR}/pkgconfig"
  COMPONENT development)
