#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Installs whatever of deploy/apt-packages.txt is missing. Does nothing, and needs no rights, when nothing is.
set -euo pipefail
cd "$(dirname "$0")"

mapfile -t wanted < <(grep -vE '^\s*(#|$)' apt-packages.txt)
missing=()
for package in "${wanted[@]}"; do
  [ "$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null)" = "install ok installed" ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

if [ "$(id -u)" = 0 ]; then as_root=(env); elif command -v sudo >/dev/null; then as_root=(sudo); else
  echo "install-packages: these packages are missing: ${missing[*]}" >&2
  echo "install-packages: run this script as root, or install sudo, or install them yourself" >&2
  exit 1
fi
echo "installing ${#missing[@]} packages: ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
