#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Installs whatever of a section of deploy/apt-packages.txt is missing. Does nothing, and needs no rights, when nothing is.
#   deploy/install-packages.sh [demo|packages|tests|full|bench]     default: tests
# For tests it also puts under build/tools what is never installed: servers and Node modules. What cannot be fetched is
# named, and the tests that need it are skipped.
set -euo pipefail
cd "$(dirname "$0")/.."

section=${1:-tests}
case "$section" in
  demo|packages|tests|full|bench) ;;
  -h|--help) sed -n '3,6s/^# \{0,1\}//p' "$0"; exit 0 ;;
  *) echo "install-packages: unknown section '$section'; see --help" >&2; exit 2 ;;
esac

packages_of() {
  awk -v wanted=" $* " '/^[ \t]*(#|$)/ { next } /^\[/ { taken = index(wanted, " " substr($0, 2, length - 2) " "); next } taken' \
    deploy/apt-packages.txt
}
case "$section" in
  demo) sections=(demo) ;;
  packages) sections=(demo packages) ;;
  tests) sections=(demo packages tests) ;;
  full) sections=(demo packages tests full) ;;
  bench) sections=(demo packages tests bench) ;;
esac
if [ "$(id -u)" = 0 ]; then as_root=(env); elif command -v sudo >/dev/null; then as_root=(sudo); else as_root=(); fi

missing=()
for package in $(packages_of "${sections[@]}"); do
  [ "$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null)" = "install ok installed" ] || command -v "$package" >/dev/null ||
    missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
  if [ ${#as_root[@]} = 0 ]; then
    echo "install-packages: these packages are missing: ${missing[*]}" >&2
    echo "install-packages: run this script as root, or install sudo, or install them yourself" >&2
    exit 1
  fi
  echo "installing ${#missing[@]} packages: ${missing[*]}"
  "${as_root[@]}" apt-get update -qq
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
fi
modules_of() {  # FOLDER, and what goes without them
  if [ ! -f "$1/package-lock.json" ] || cmp -s "$1/package-lock.json" "$1/node_modules/.installed"; then return; fi
  if (cd "$1" && npm ci --silent --no-audit --no-fund --ignore-scripts) >/dev/null 2>&1; then
    cp "$1/package-lock.json" "$1/node_modules/.installed"
  else
    echo "install-packages: npm cannot fetch the modules of $1/package-lock.json; $2 is left out" >&2
  fi
}
modules_of web 'the page'
[ "$section" = demo ] || modules_of web/examples 'the package for npm'
[[ $section != demo && $section != packages ]] || exit 0

tools=$PWD/build/tools
mkdir -p "$tools/bin"
for package in $(packages_of unpacked); do
  program=$package
  [ "$package" != prometheus ] || program=promtool
  [ ! -x "$tools/bin/$program" ] || continue
  if found=$(PATH=$PATH:/usr/sbin command -v "$program"); then ln -sfn "$found" "$tools/bin/$program"; continue; fi
  folder=$tools/$package
  rm -rf "$folder"
  mkdir -p "$folder"
  fetch() { (cd "$folder" && apt-get download -qq -o APT::Sandbox::User=root "$package") >/dev/null 2>&1; }
  if fetch || { [ ${#as_root[@]} -gt 0 ] && "${as_root[@]}" apt-get update -qq && fetch; }; then
    dpkg -x "$folder"/*.deb "$folder"
    rm "$folder"/*.deb
    (cd "$tools/bin" && ln -sfn "$(find "../$package" -name "$program" -path '*bin/*')" "$program")
  else
    echo "install-packages: $package cannot be fetched; tests that need $program will be skipped" >&2
  fi
done

modules=$tools/node lock=tests/support/node/package-lock.json
if ! cmp -s "$lock" "$modules/package-lock.json" || [ ! -d "$modules/node_modules" ]; then
  rm -rf "$modules"
  mkdir -p "$modules"
  cp "$lock" tests/support/node/package.json tests/support/node/.npmrc "$modules"
  (cd "$modules" && npm ci --silent --no-audit --no-fund) >/dev/null 2>&1 || {
    rm -rf "$modules"
    echo "install-packages: npm cannot fetch the modules of $lock; tests that need them will be skipped" >&2
  }
fi
