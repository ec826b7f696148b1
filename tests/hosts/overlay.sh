#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Runs a command on this machine as it would be with other packages: overlay.sh FOLDER PACKAGE... -- COMMAND...
# They are installed on layers over /usr, /etc and /var that only the command sees, and that are removed with FOLDER. Needs root and a
# package mirror; what was downloaded stays in apt's cache.
set -euo pipefail
folder=$1
shift
if [ "${EIGENCAST_OVERLAY:-}" != "$folder" ]; then
  [ "$(id -u)" = 0 ] || { echo "overlay.sh: only root can mount layers over /usr: run the test as root" >&2; exit 1; }
  rm -rf "$folder"
  mkdir -p "$folder"
  trap 'rm -rf "$folder"' EXIT
  EIGENCAST_OVERLAY=$folder unshare --mount --fork --kill-child "$0" "$folder" "$@"
  exit
fi

packages=()
while [ "$1" != -- ]; do packages+=("$1"); shift; done
shift
layer() { mount -t overlay overlay -o "lowerdir=/$1,upperdir=$folder/$1,workdir=$folder/work-$1" "/$1"; }
layers() { mkdir -p "$folder"/{archives,usr,etc,var,work-usr,work-etc,work-var} && layer usr 2>/dev/null; }
# Where FOLDER lies in a layer itself, as in a container, the new ones are kept in memory.
layers || { mount -t tmpfs tmpfs "$folder" && layers; } ||
  { echo "overlay.sh: the kernel refuses a layer over /usr in $folder: is overlayfs allowed here?" >&2; exit 1; }
mount --bind /var/cache/apt/archives "$folder/archives"
layer etc
layer var
mount --bind "$folder/archives" /var/cache/apt/archives
printf '#!/bin/sh\nexit 101\n' >/usr/sbin/policy-rc.d  # no service starts
chmod +x /usr/sbin/policy-rc.d
install() { DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${packages[@]}" >"$folder/apt.log" 2>&1; }
install || { apt-get update -qq && install; } || { cat "$folder/apt.log" >&2; exit 1; }
"$@"
