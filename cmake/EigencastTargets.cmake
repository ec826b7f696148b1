# SPDX-License-Identifier: MIT
# One function per kind of target, so that every folder's CMakeLists.txt says only what is particular to it.

find_package(Threads REQUIRED)

# Flags every target of this tree shares. Presets add optimisation, sanitizers, hardening and -Werror.
add_library(eigencast_flags INTERFACE)
target_compile_features(eigencast_flags INTERFACE cxx_std_20)
target_compile_options(eigencast_flags INTERFACE
  $<$<COMPILE_LANGUAGE:CXX>:-Wall -Wextra -Wshadow -Wnon-virtual-dtor -Wold-style-cast -Wcast-qual>)
target_include_directories(eigencast_flags INTERFACE "${PROJECT_SOURCE_DIR}")

# eigencast_library(NAME SOURCES a.cpp... [DEPENDS core wire...] [LINKS Eigen3::Eigen...] [PRIVATE_LINKS ...])
# makes the static library eigencast_NAME. DEPENDS names rooms of common/; LINKS are third-party targets
# that appear in this room's headers; PRIVATE_LINKS those that only its sources see.
function(eigencast_library NAME)
  cmake_parse_arguments(ARG "" "" "SOURCES;DEPENDS;LINKS;PRIVATE_LINKS" ${ARGN})
  add_library(eigencast_${NAME} STATIC ${ARG_SOURCES})
  set_target_properties(eigencast_${NAME} PROPERTIES POSITION_INDEPENDENT_CODE ON
                        CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
  target_link_libraries(eigencast_${NAME} PUBLIC ${ARG_LINKS}
                        PRIVATE $<BUILD_INTERFACE:eigencast_flags> ${ARG_PRIVATE_LINKS})
  foreach(ROOM IN LISTS ARG_DEPENDS)
    target_link_libraries(eigencast_${NAME} PUBLIC eigencast_${ROOM})
  endforeach()
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

# eigencast_documents(PROGRAM [COMPONENT ...]) makes and installs the manual page and the completion scripts that PROGRAM writes
# about itself (`PROGRAM man`, `PROGRAM completion SHELL`), all from its one table of options.
function(eigencast_documents PROGRAM)
  cmake_parse_arguments(ARG "" "COMPONENT" "" ${ARGN})
  if(NOT ARG_COMPONENT)
    set(ARG_COMPONENT tools)
  endif()
  if(CMAKE_CROSSCOMPILING AND NOT CMAKE_CROSSCOMPILING_EMULATOR)
    message(STATUS "${PROGRAM}: no manual page and no completion scripts, which a cross build cannot make")
    return()
  endif()
  set(DIR "${PROJECT_BINARY_DIR}/share")
  set(PAGE "${DIR}/man/man1/${PROGRAM}.1")
  set(MAN "${PAGE}.gz")
  set(BASH "${DIR}/bash-completion/completions/${PROGRAM}")
  set(ZSH "${DIR}/zsh/vendor-completions/_${PROGRAM}")
  set(FISH "${DIR}/fish/vendor_completions.d/${PROGRAM}.fish")
  foreach(FILE IN ITEMS "${MAN}" "${BASH}" "${ZSH}" "${FISH}")
    cmake_path(GET FILE PARENT_PATH PARENT)
    file(MAKE_DIRECTORY "${PARENT}")
    cmake_path(RELATIVE_PATH PARENT BASE_DIRECTORY "${DIR}" OUTPUT_VARIABLE BELOW)
    install(FILES "${FILE}" DESTINATION "${CMAKE_INSTALL_DATADIR}/${BELOW}" COMPONENT ${ARG_COMPONENT})
  endforeach()
  add_custom_command(OUTPUT "${MAN}" "${BASH}" "${ZSH}" "${FISH}"
    COMMAND ${PROGRAM} man > "${PAGE}"
    COMMAND gzip -9nf "${PAGE}"
    COMMAND ${PROGRAM} completion bash > "${BASH}"
    COMMAND ${PROGRAM} completion zsh > "${ZSH}"
    COMMAND ${PROGRAM} completion fish > "${FISH}"
    DEPENDS ${PROGRAM} VERBATIM)
  add_custom_target(${PROGRAM}-documents ALL DEPENDS "${MAN}" "${BASH}" "${ZSH}" "${FISH}")
endfunction()

# eigencast_test(NAME SOURCES ... LINKS ... [LABELS ...] [TIMEOUT s] [PROPERTIES FIXTURES_REQUIRED x...]) makes a GoogleTest binary whose
# cases ctest sees one by one.
# Its sources are 40 % of a build's time: a fifth quicker with -O1, a third with GoogleTest's headers compiled once for all tests.
function(eigencast_test NAME)
  cmake_parse_arguments(ARG "" "TIMEOUT" "SOURCES;LINKS;LABELS;PROPERTIES" ${ARGN})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  add_executable(${NAME} ${ARG_SOURCES})
  target_compile_options(${NAME} PRIVATE -O1)
  target_link_libraries(${NAME} PRIVATE eigencast_flags ${ARG_LINKS} GTest::gtest_main GTest::gmock)
  target_precompile_headers(${NAME} REUSE_FROM eigencast_test_headers)
  # GCC 12 suspects its own std::string (bugs 105329, 105651) where that comes from a precompiled header.
  target_compile_options(${NAME} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-array-bounds> $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>
                         $<$<CXX_COMPILER_ID:GNU>:-Wno-stringop-overflow>)
  target_compile_definitions(${NAME} PRIVATE
    EIGENCAST_DATA_DIR="${PROJECT_SOURCE_DIR}/../shared/data"
    EIGENCAST_GOLDEN_DIR="${PROJECT_SOURCE_DIR}/tests/golden"
    EIGENCAST_BIN_DIR="${PROJECT_BINARY_DIR}/bin")
  include(GoogleTest)
  gtest_discover_tests(${NAME} DISCOVERY_TIMEOUT 60
    PROPERTIES TIMEOUT ${ARG_TIMEOUT} LABELS "${ARG_LABELS}" ${ARG_PROPERTIES})
endfunction()

# eigencast_kernel_variants(TARGET NAME) adds NAME_avx2.cpp and NAME_avx512.cpp, and NAME_avx512vnni.cpp where there is one, compiled
# for those processors, where they mean something. NAME_baseline.cpp, which every build has, is compiled as they are otherwise: with full optimisation, and
# with multiplications and additions fused where the processor can.
function(eigencast_kernel_variants TARGET NAME)
  set(COMMON -O3 -ffp-contract=fast)
  set_source_files_properties(${NAME}_baseline.cpp PROPERTIES COMPILE_OPTIONS "${COMMON}")
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
    set_source_files_properties(${NAME}_avx2.cpp PROPERTIES COMPILE_OPTIONS "${COMMON};-mavx2;-mfma")
    set(AVX512 -mavx2 -mfma -mavx512f -mavx512bw -mavx512dq -mavx512vl -mprefer-vector-width=512)
    set_source_files_properties(${NAME}_avx512.cpp PROPERTIES COMPILE_OPTIONS "${COMMON};${AVX512}")
    target_sources(${TARGET} PRIVATE ${NAME}_avx2.cpp ${NAME}_avx512.cpp)
    if(EXISTS "${CMAKE_CURRENT_SOURCE_DIR}/${NAME}_avx512vnni.cpp")
      set_source_files_properties(${NAME}_avx512vnni.cpp PROPERTIES COMPILE_OPTIONS "${COMMON};${AVX512};-mavx512vnni")
      target_sources(${TARGET} PRIVATE ${NAME}_avx512vnni.cpp)
    endif()
  endif()
endfunction()
