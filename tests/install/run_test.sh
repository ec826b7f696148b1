#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Installs the build into a folder of its own, then builds and runs a consumer against it: through CMake and through pkg-config.
#   run_test.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
build=$1 source=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cmake --install "$build" --prefix "$work/prefix" >"$work/install.log" || { cat "$work/install.log"; exit 1; }
for program in "$work"/prefix/bin/eigencast-*; do "$program" --version; done

cmake -S "$source/tests/install/consumer" -B "$work/consumer" -DCMAKE_PREFIX_PATH="$work/prefix" >"$work/configure.log" ||
  { cat "$work/configure.log"; exit 1; }
cmake --build "$work/consumer" >"$work/build.log" || { cat "$work/build.log"; exit 1; }
"$work/consumer/consumer_cpp"
"$work/consumer/consumer_c"

pc=$(dirname "$(find "$work/prefix" -name eigencast.pc)")
export PKG_CONFIG_PATH=$pc LD_LIBRARY_PATH=$work/prefix/lib:$work/prefix/lib/x86_64-linux-gnu
# shellcheck disable=SC2046
c++ -std=c++20 "$source/tests/install/consumer/consumer.cpp" $(pkg-config --cflags --libs eigencast) -o "$work/by_pkg_config"
"$work/by_pkg_config"

# Only the C interface leaves the library.
library=$(find "$work/prefix" -name libeigencast.so)
others=$(nm -D --defined-only "$library" | awk '$3 !~ /^ec_/ {print $3}')
[ -z "$others" ] || { echo "symbols beside ec_* are exported: $others"; exit 1; }
echo "installed tree works"
