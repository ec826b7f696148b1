# SPDX-License-Identifier: MIT
# Debian packages, one per component: `cmake --preset release -DCMAKE_INSTALL_PREFIX=/usr`, build, `cpack -G DEB`; or at once:
# deploy/packages.sh. What each holds besides the programs and the library is installed here.
set(EIGENCAST_PACKAGE_CONTACT "The Eigencast authors <packages@eigencast.example>" CACHE STRING "Maintainer field of the packages")

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_VENDOR "Eigencast")
set(CPACK_PACKAGE_CONTACT "${EIGENCAST_PACKAGE_CONTACT}")
# Each component's first line is its package's summary: CPack would put the project's before it.
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_COMPONENTS_ALL broker tools igtl library development python)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS "${PROJECT_BINARY_DIR}/lib")
set(CPACK_DEBIAN_PACKAGE_GENERATE_SHLIBS ON)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)

# What dpkg is given with a package, of the folder of deploy/debian that has its name.
macro(eigencast_package_scripts PACKAGE COMPONENT)
  set(CPACK_DEBIAN_${COMPONENT}_PACKAGE_CONTROL_EXTRA ${ARGN})
  list(TRANSFORM CPACK_DEBIAN_${COMPONENT}_PACKAGE_CONTROL_EXTRA PREPEND "${PROJECT_SOURCE_DIR}/deploy/debian/${PACKAGE}/")
endmacro()

set(CPACK_DEBIAN_BROKER_PACKAGE_NAME eigencast-broker)
set(CPACK_DEBIAN_BROKER_PACKAGE_SECTION net)
set(CPACK_DEBIAN_BROKER_PACKAGE_DEPENDS "adduser")
set(CPACK_DEBIAN_BROKER_PACKAGE_RECOMMENDS "curl, openssl")
set(CPACK_DEBIAN_BROKER_PACKAGE_SUGGESTS "nginx, prometheus")
set(CPACK_COMPONENT_BROKER_DESCRIPTION "relays deforming 3D surfaces to many viewers
The broker takes frames of spectral coefficients from senders, interpolates
them to a multiple of their rate, and relays them over WebSockets to any
number of viewers, each at its own rate and bandwidth. It keeps the surfaces
themselves as content-addressed assets.")
eigencast_package_scripts(eigencast-broker BROKER conffiles postinst prerm postrm)

set(CPACK_DEBIAN_TOOLS_PACKAGE_NAME eigencast-tools)
set(CPACK_DEBIAN_TOOLS_PACKAGE_SECTION graphics)
# libepoxy loads these by name, where no linker sees it; certificates are checked against the system's authorities.
set(CPACK_DEBIAN_TOOLS_PACKAGE_DEPENDS "ca-certificates, libegl1, libgl1")
set(CPACK_DEBIAN_TOOLS_PACKAGE_RECOMMENDS "fonts-dejavu-core, libgl1-mesa-dri")
set(CPACK_DEBIAN_TOOLS_PACKAGE_SUGGESTS "ffmpeg")
set(CPACK_COMPONENT_TOOLS_DESCRIPTION "sender, native viewer and latency meter for deforming 3D surfaces
The sender bakes meshes and point clouds into streamable assets and publishes
their motion; the viewer rebuilds the surface at a level of detail that holds
its frame rate; the latency meter says where the time between them goes.")

set(CPACK_DEBIAN_IGTL_PACKAGE_NAME eigencast-igtl)
set(CPACK_DEBIAN_IGTL_PACKAGE_SECTION net)
set(CPACK_DEBIAN_IGTL_PACKAGE_DEPENDS "ca-certificates")
set(CPACK_COMPONENT_IGTL_DESCRIPTION "bridge between streams of deforming 3D surfaces and OpenIGTLink
Surfaces that 3D Slicer and other programs send as POLYDATA become a stream,
and a stream is sent to them; it needs neither a display nor their libraries.")

set(CPACK_DEBIAN_LIBRARY_PACKAGE_NAME "libeigencast0")
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SECTION libs)
eigencast_package_scripts(libeigencast0 LIBRARY triggers)
set(CPACK_COMPONENT_LIBRARY_DESCRIPTION "publish and watch deforming 3D surfaces from any program
A C interface, with C++ over it, to bake a surface, publish its poses without
ever blocking, and subscribe to what others publish.")

set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_NAME libeigencast-dev)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEVELOPMENT_PACKAGE_DEPENDS "libeigencast0 (= ${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE})")
set(CPACK_COMPONENT_DEVELOPMENT_DESCRIPTION "headers of libeigencast
Headers, CMake package and pkg-config file to build programs that publish or
watch deforming 3D surfaces.")

set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-eigencast)
set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
set(CPACK_DEBIAN_PYTHON_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_PYTHON_PACKAGE_SHLIBDEPS OFF)
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "libeigencast0 (>= ${PROJECT_VERSION}), python3, python3-numpy")
# What draws pictures, and what shows them in notebooks.
set(CPACK_DEBIAN_PYTHON_PACKAGE_SUGGESTS "eigencast-tools, jupyter-notebook")
# Compiled modules beside the sources come with the package and go with it, whoever imports them.
eigencast_package_scripts(python3-eigencast PYTHON postinst prerm)
set(CPACK_COMPONENT_PYTHON_DESCRIPTION "publish and watch deforming 3D surfaces from Python
A package over libeigencast by ctypes and numpy: bake a surface, publish its
poses without ever blocking, and subscribe to what others publish.")

# The broker's package: unit, socket, annotated configuration, and what stands around a broker as examples.
install(FILES deploy/systemd/eigencast-broker.service deploy/systemd/eigencast-broker.socket
  DESTINATION lib/systemd/system COMPONENT broker)
install(FILES deploy/eigencast.toml DESTINATION /etc/eigencast COMPONENT broker)
install(DIRECTORY deploy/nginx deploy/nats deploy/prometheus deploy/grafana DESTINATION share/doc/eigencast-broker/examples COMPONENT broker)
install(FILES deploy/desktop/eigencast-client.desktop DESTINATION share/applications COMPONENT tools)
install(FILES deploy/desktop/eigencast.xml DESTINATION share/mime/packages COMPONENT tools)
install(FILES deploy/desktop/eigencast-client.svg DESTINATION share/icons/hicolor/scalable/apps COMPONENT tools)
install(FILES examples/publish.c examples/subscribe.c examples/publish.cpp examples/subscribe.cpp
  DESTINATION share/doc/libeigencast-dev/examples COMPONENT development)
install(FILES examples/publish.py examples/subscribe.py examples/stress.py examples/painted.py examples/springs.py examples/markers.py
  DESTINATION share/doc/python3-eigencast/examples COMPONENT python)

# Every package states its licence and its history, and holds the documents for its users, compressed as Debian wants them. Manual
# pages and completions come with the programs (eigencast_documents).
string(TIMESTAMP EIGENCAST_PACKAGE_DATE "%a, %d %b %Y %H:%M:%S +0000" UTC)
configure_file(deploy/debian/changelog.in "${PROJECT_BINARY_DIR}/packages/changelog.Debian" @ONLY)
configure_file(CHANGELOG.md "${PROJECT_BINARY_DIR}/packages/changelog" COPYONLY)
find_program(GZIP gzip REQUIRED)
function(eigencast_package_documents PACKAGE COMPONENT)
  set(COMPRESSED)
  foreach(DOCUMENT IN ITEMS "${PROJECT_BINARY_DIR}/packages/changelog.Debian" "${PROJECT_BINARY_DIR}/packages/changelog" ${ARGN})
    cmake_path(ABSOLUTE_PATH DOCUMENT)
    cmake_path(GET DOCUMENT FILENAME NAME)
    # Programs name client/README.md, docs/latency.md: the first keeps its folder here.
    set(FOLDER "")
    if(NAME STREQUAL README.md)
      cmake_path(GET DOCUMENT PARENT_PATH FOLDER)
      cmake_path(GET FOLDER FILENAME FOLDER)
      set(NAME "${FOLDER}/${NAME}")
    endif()
    set(OUTPUT "${PROJECT_BINARY_DIR}/packages/${PACKAGE}/${NAME}.gz")
    file(MAKE_DIRECTORY "${PROJECT_BINARY_DIR}/packages/${PACKAGE}/${FOLDER}")
    add_custom_command(OUTPUT "${OUTPUT}" COMMAND "${GZIP}" -9nc "${DOCUMENT}" > "${OUTPUT}" DEPENDS "${DOCUMENT}" VERBATIM)
    list(APPEND COMPRESSED "${OUTPUT}")
    install(FILES "${OUTPUT}" DESTINATION "share/doc/${PACKAGE}/${FOLDER}" COMPONENT ${COMPONENT})
  endforeach()
  add_custom_target("${PACKAGE}-package-documents" ALL DEPENDS ${COMPRESSED})
  install(FILES deploy/debian/copyright DESTINATION "share/doc/${PACKAGE}" COMPONENT ${COMPONENT})
endfunction()
eigencast_package_documents(eigencast-broker broker docs/operations.md docs/scaling.md)
eigencast_package_documents(eigencast-tools tools docs/formats.md docs/deform.md docs/latency.md docs/time.md
  client/README.md sender/README.md)
eigencast_package_documents(eigencast-igtl igtl)
eigencast_package_documents(libeigencast0 library)
eigencast_package_documents(libeigencast-dev development docs/protocol.md docs/asset-format.md docs/sdk.md)
eigencast_package_documents(python3-eigencast python docs/sdk.md)
include(CPack)
