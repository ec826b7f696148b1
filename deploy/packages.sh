#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Builds the Debian packages of this tree, its wheel for Python, its package for npm and its add-on for Blender into a
# folder (default: out/packages); installs what the build needs first.
#   deploy/packages.sh [FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
case "${1:-}" in -h|--help) sed -n '3,5s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
out=${1:-out/packages}

deploy/install-packages.sh packages
cmake --preset release -B build/packages -DCMAKE_INSTALL_PREFIX=/usr -DEIGENCAST_BUILD_TESTS=OFF >/dev/null
cmake --build build/packages -j"$(nproc)"
mkdir -p "$out"
rm -f "$out"/*.deb "$out"/eigencast-*.tgz "$out"/eigencast-*.whl
(cd build/packages && cpack -G DEB >/dev/null)
mv build/packages/*.deb "$out"/
# Finds the library of libeigencast0.
python3 tools/blender/pack.py "$out"/eigencast-blender.zip
version=$(sed -n 's/^CMAKE_PROJECT_VERSION:STATIC=//p' build/packages/CMakeCache.txt)
deploy/wheel.py build/packages/lib/libeigencast.so.0 "$version" "$out" >/dev/null
# Its types are those of web/examples/node_modules.
if [ -f build/packages/web/eigencast-core.wasm ] && [ -d web/examples/node_modules/three ]; then
  node web/pack.mjs build/packages/web "$out" >/dev/null
else
  echo "packages: without eigencast-VERSION.tgz, which takes clang for WebAssembly and the modules of npm" >&2
fi
find "$out" -name "*.deb" -o -name "eigencast-*.tgz" -o -name "*.whl" -o -name "eigencast-*.zip" | sort
