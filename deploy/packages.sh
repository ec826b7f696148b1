#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Builds the Debian packages of this tree into a folder (default: out/packages); installs what the build needs first.
#   deploy/packages.sh [FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
case "${1:-}" in -h|--help) sed -n '3,4s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
out=${1:-out/packages}

deploy/install-packages.sh packages
cmake --preset release -B build/packages -DCMAKE_INSTALL_PREFIX=/usr -DEIGENCAST_BUILD_TESTS=OFF >/dev/null
cmake --build build/packages -j"$(nproc)"
mkdir -p "$out"
rm -f "$out"/*.deb
(cd build/packages && cpack -G DEB >/dev/null)
mv build/packages/*.deb "$out"/
ls "$out"/*.deb
