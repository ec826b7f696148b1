# SPDX-License-Identifier: MIT
# One function per kind of target, so that every folder's CMakeLists.txt says only what is particular to it.

find_package(Threads REQUIRED)

# Flags every target of this tree shares. Presets add optimisation, sanitizers, hardening and -Werror.
add_library(eigencast_flags INTERFACE)
target_compile_features(eigencast_flags INTERFACE cxx_std_20)
target_compile_options(eigencast_flags INTERFACE
  $<$<COMPILE_LANGUAGE:CXX>:-Wall -Wextra -Wshadow -Wnon-virtual-dtor -Wold-style-cast -Wcast-qual>)
target_include_directories(eigencast_flags INTERFACE "${PROJECT_SOURCE_DIR}")
# Libraries that only other programs' rooms call are no dependency of a package.
target_link_options(eigencast_flags INTERFACE "-Wl,--as-needed")
if(CMAKE_UNITY_BUILD)
  # GCC takes a source that another one includes for a header, whose types in anonymous namespaces it warns of.
  target_compile_options(eigencast_flags INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
endif()

# What is included all over the tree, and no more: of what stands here each source pays for the inline functions, used or not.
set(EIGENCAST_COMMON_HEADERS
  <algorithm> <array> <cmath> <cstddef> <cstdint> <cstdio> <cstring> <functional> <limits> <map> <memory> <optional> <span> <string> <string_view>
  <utility> <variant> <vector>)

# eigencast_precompiled_headers(NAME HEADERS <vector>... [LINKS ...] [OPTIONS -O1...] [FOR_LIBRARIES]) compiles headers once for all targets
# that are compiled in the same way and say so with eigencast_use_precompiled(): a fifth to a third of what a source takes to compile.
# Sources include what they use all the same; builds with CMAKE_DISABLE_PRECOMPILE_HEADERS (asan, tidy, fuzz) see to it.
function(eigencast_precompiled_headers NAME)
  cmake_parse_arguments(ARG "FOR_LIBRARIES" "" "HEADERS;LINKS;OPTIONS" ${ARGN})
  add_library(${NAME} OBJECT "${PROJECT_SOURCE_DIR}/cmake/headers.cpp")
  if(ARG_FOR_LIBRARIES)
    set_target_properties(${NAME} PROPERTIES POSITION_INDEPENDENT_CODE ON CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
  else()
    set_target_properties(${NAME} PROPERTIES POSITION_INDEPENDENT_CODE OFF)
    if(CMAKE_POSITION_INDEPENDENT_CODE)
      target_compile_options(${NAME} PRIVATE ${CMAKE_CXX_COMPILE_OPTIONS_PIE})
    endif()
  endif()
  target_compile_options(${NAME} PRIVATE ${ARG_OPTIONS})
  target_link_libraries(${NAME} PRIVATE eigencast_flags Threads::Threads ${ARG_LINKS})
  target_precompile_headers(${NAME} PRIVATE ${ARG_HEADERS})
endfunction()

function(eigencast_use_precompiled TARGET HEADERS)
  if(CMAKE_DISABLE_PRECOMPILE_HEADERS)
    return()
  endif()
  target_precompile_headers(${TARGET} REUSE_FROM ${HEADERS})
  # GCC 12 suspects its own std::string (bugs 105329, 105651) where that comes from a precompiled header.
  target_compile_options(${TARGET} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds> $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>
                         $<$<CXX_COMPILER_ID:GNU>:-Wno-stringop-overflow> $<$<CXX_COMPILER_ID:GNU>:-Wno-stringop-overread>)
endfunction()

eigencast_precompiled_headers(eigencast_headers FOR_LIBRARIES HEADERS ${EIGENCAST_COMMON_HEADERS})

# eigencast_library(NAME SOURCES a.cpp... [DEPENDS core wire...] [LINKS Eigen3::Eigen...] [PRIVATE_LINKS ...] [PRECOMPILED eigencast_headers])
# makes the static library eigencast_NAME. DEPENDS names rooms of common/; LINKS are third-party targets
# that appear in this room's headers; PRIVATE_LINKS those that only its sources see; PRECOMPILED names its precompiled headers.
function(eigencast_library NAME)
  cmake_parse_arguments(ARG "" "PRECOMPILED" "SOURCES;DEPENDS;LINKS;PRIVATE_LINKS" ${ARGN})
  add_library(eigencast_${NAME} STATIC ${ARG_SOURCES})
  set_target_properties(eigencast_${NAME} PROPERTIES POSITION_INDEPENDENT_CODE ON
                        CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
  target_link_libraries(eigencast_${NAME} PUBLIC ${ARG_LINKS}
                        PRIVATE $<BUILD_INTERFACE:eigencast_flags> ${ARG_PRIVATE_LINKS})
  foreach(ROOM IN LISTS ARG_DEPENDS)
    target_link_libraries(eigencast_${NAME} PUBLIC eigencast_${ROOM})
  endforeach()
  if(NOT ARG_PRECOMPILED)
    set(ARG_PRECOMPILED eigencast_headers)
  endif()
  eigencast_use_precompiled(eigencast_${NAME} ${ARG_PRECOMPILED})
endfunction()

# eigencast_program(NAME SOURCES ... LINKS ... [COMPONENT tools]) makes the executable NAME and installs it into the package of
# that component (cmake/Packages.cmake).
function(eigencast_program NAME)
  cmake_parse_arguments(ARG "" "COMPONENT" "SOURCES;LINKS" ${ARGN})
  if(NOT ARG_COMPONENT)
    set(ARG_COMPONENT tools)
  endif()
  add_executable(${NAME} ${ARG_SOURCES})
  target_link_libraries(${NAME} PRIVATE eigencast_flags ${ARG_LINKS})
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
  install(TARGETS ${NAME} RUNTIME DESTINATION "${CMAKE_INSTALL_BINDIR}" COMPONENT ${ARG_COMPONENT})
endfunction()

# eigencast_documents(PROGRAM SUMMARY "..." [COMPONENT ...]) makes and installs the completion scripts that PROGRAM writes, and its manual
# page from what it says to --help-all, where help2man is there (packages want it).
find_program(HELP2MAN help2man)
function(eigencast_documents PROGRAM)
  cmake_parse_arguments(ARG "" "COMPONENT;SUMMARY" "" ${ARGN})
  if(NOT ARG_COMPONENT)
    set(ARG_COMPONENT tools)
  endif()
  if(CMAKE_CROSSCOMPILING AND NOT CMAKE_CROSSCOMPILING_EMULATOR)
    message(STATUS "${PROGRAM}: no manual page and no completion scripts, which a cross build cannot make")
    return()
  endif()
  set(DIR "${PROJECT_BINARY_DIR}/share")
  set(BASH "${DIR}/bash-completion/completions/${PROGRAM}")
  set(ZSH "${DIR}/zsh/vendor-completions/_${PROGRAM}")
  set(FILES "${BASH}" "${ZSH}")
  set(MAKE_PAGE)
  if(HELP2MAN)
    set(PAGE "${DIR}/man/man1/${PROGRAM}.1")
    list(APPEND FILES "${PAGE}.gz")
    set(MAKE_PAGE COMMAND "${HELP2MAN}" --no-info --help-option=--help-all "--name=${ARG_SUMMARY}" "--output=${PAGE}" "$<TARGET_FILE:${PROGRAM}>"
                  COMMAND gzip -9nf "${PAGE}")
  else()
    message(STATUS "${PROGRAM}: no manual page (help2man)")
  endif()
  foreach(FILE IN LISTS FILES)
    cmake_path(GET FILE PARENT_PATH PARENT)
    file(MAKE_DIRECTORY "${PARENT}")
    cmake_path(RELATIVE_PATH PARENT BASE_DIRECTORY "${DIR}" OUTPUT_VARIABLE BELOW)
    install(FILES "${FILE}" DESTINATION "${CMAKE_INSTALL_DATADIR}/${BELOW}" COMPONENT ${ARG_COMPONENT})
  endforeach()
  add_custom_command(OUTPUT ${FILES}
    COMMAND ${PROGRAM} completion bash > "${BASH}"
    COMMAND ${PROGRAM} completion zsh > "${ZSH}"
    ${MAKE_PAGE}
    DEPENDS ${PROGRAM} VERBATIM)
  add_custom_target(${PROGRAM}-documents ALL DEPENDS ${FILES})
endfunction()

# eigencast_test(NAME SOURCES ... LINKS ... [LABELS ...] [TIMEOUT s] [PROPERTIES FIXTURES_REQUIRED x...]) makes a GoogleTest binary whose
# cases ctest sees one by one. Its sources are a third of a build's time, and a fifth quicker with -O1.
function(eigencast_test NAME)
  cmake_parse_arguments(ARG "" "TIMEOUT" "SOURCES;LINKS;LABELS;PROPERTIES" ${ARGN})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  add_executable(${NAME} ${ARG_SOURCES})
  target_compile_options(${NAME} PRIVATE -O1)
  target_link_libraries(${NAME} PRIVATE eigencast_flags ${ARG_LINKS} eigencast_test_paths GTest::gtest_main GTest::gmock)
  eigencast_use_precompiled(${NAME} eigencast_test_headers)
  include(GoogleTest)
  gtest_discover_tests(${NAME} DISCOVERY_TIMEOUT 60
    PROPERTIES TIMEOUT ${ARG_TIMEOUT} LABELS "${ARG_LABELS}" ${ARG_PROPERTIES})
endfunction()

# eigencast_kernel_variants(TARGET NAME) adds NAME_avx2.cpp and NAME_avx512.cpp, and NAME_avx512vnni.cpp where there is one, compiled
# for those processors, where they mean something. NAME_baseline.cpp, which every build has, is compiled as they are otherwise: with full optimisation, and
# with multiplications and additions fused where the processor can.
function(eigencast_kernel_variants TARGET NAME)
  set(COMMON -O3 -ffp-contract=fast)
  set_source_files_properties(${NAME}_baseline.cpp PROPERTIES COMPILE_OPTIONS "${COMMON}" SKIP_PRECOMPILE_HEADERS ON)
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
    set_source_files_properties(${NAME}_avx2.cpp PROPERTIES COMPILE_OPTIONS "${COMMON};-mavx2;-mfma" SKIP_PRECOMPILE_HEADERS ON)
    set(AVX512 -mavx2 -mfma -mavx512f -mavx512bw -mavx512dq -mavx512vl -mprefer-vector-width=512)
    set_source_files_properties(${NAME}_avx512.cpp PROPERTIES COMPILE_OPTIONS "${COMMON};${AVX512}" SKIP_PRECOMPILE_HEADERS ON)
    target_sources(${TARGET} PRIVATE ${NAME}_avx2.cpp ${NAME}_avx512.cpp)
    if(EXISTS "${CMAKE_CURRENT_SOURCE_DIR}/${NAME}_avx512vnni.cpp")
      set_source_files_properties(${NAME}_avx512vnni.cpp PROPERTIES COMPILE_OPTIONS "${COMMON};${AVX512};-mavx512vnni" SKIP_PRECOMPILE_HEADERS ON)
      target_sources(${TARGET} PRIVATE ${NAME}_avx512vnni.cpp)
    endif()
  endif()
endfunction()
