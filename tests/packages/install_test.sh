#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Installs, upgrades, removes and purges the Debian packages in a clean root of its own, and says what each step left behind.
#   tests/packages/install_test.sh FOLDER     FOLDER holds the .deb files of one version (deploy/packages.sh)
# Needs root, mmdebstrap and lintian; fetches the clean root through the machine's own apt configuration. Exit 77: cannot run here.
set -euo pipefail

debs=$(cd "${1:?usage: install_test.sh FOLDER}" && pwd)
[ "$(id -u)" = 0 ] || { echo "SKIPPED: needs root for a chroot"; exit 77; }
for tool in mmdebstrap lintian dpkg-deb; do
  command -v $tool >/dev/null || { echo "SKIPPED: $tool is not installed"; exit 77; }
done
failed=0
check() { local what=$1; shift; if "$@"; then echo "ok    $what"; else echo "FAIL  $what"; failed=1; fi; }

check "lintian finds no error" lintian --allow-root --fail-on error "$debs"/*.deb

root=$(mktemp -d)
cleanup() { umount "$root/proc" 2>/dev/null || true; rm -rf --one-file-system "$root"; }
trap cleanup EXIT
mmdebstrap --quiet --variant=apt bookworm "$root" || { echo "SKIPPED: no clean root could be made (no package mirror?)"; exit 77; }
mount -t proc proc "$root/proc"
inside() { chroot "$root" env DEBIAN_FRONTEND=noninteractive PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"; }
cp /etc/resolv.conf "$root/etc/resolv.conf"
cp /etc/apt/apt.conf.d/*proxy* "$root/etc/apt/apt.conf.d/" 2>/dev/null || true
inside apt-get update -qq || { echo "SKIPPED: the package mirror cannot be reached from the clean root"; exit 77; }
mkdir "$root/debs"
cp "$debs"/*.deb "$root/debs/"

check "apt installs all packages" inside sh -c 'apt-get install -y -qq --no-install-recommends /debs/*.deb >/debs/log 2>&1 || { cat /debs/log; exit 1; }'
check "the user exists" inside getent passwd eigencast
check "the state folder is the user's alone" inside sh -c '[ "$(stat -c "%U %a" /var/lib/eigencast)" = "eigencast 750" ]'
check "the installed configuration is valid" inside eigencast-broker --config /etc/eigencast/eigencast.toml --check-config
check "every program says its version" inside sh -c 'for p in eigencast-broker eigencast-sender eigencast-client; do $p --version || exit 1; done'
check "the broker runs as its user and answers" inside sh -c '
  su -s /bin/sh eigencast -c "echo \$\$ >/tmp/pid; exec eigencast-broker --config /etc/eigencast/eigencast.toml --listen 127.0.0.1:0 --data-dir /var/lib/eigencast --port-file /tmp/port" &
  for i in $(seq 50); do [ -s /tmp/port ] && break; sleep 0.1; done; [ -s /tmp/port ]; ok=$?; kill $(cat /tmp/pid); wait; exit $ok'

# An upgrade over a changed configuration keeps it.
echo '# changed by the administrator' >>"$root/etc/eigencast/eigencast.toml"
mkdir "$root/newer"
dpkg-deb -R "$root"/debs/eigencast-broker_*.deb "$root/newer/tree"
sed -i 's/^Version: .*/Version: 99.0-1/' "$root/newer/tree/DEBIAN/control"
echo '# a new comment upstream' >>"$root/newer/tree/etc/eigencast/eigencast.toml"
(cd "$root/newer/tree" && md5sum $(find . -type f -not -path './DEBIAN/*' -printf '%P ') >DEBIAN/md5sums)
dpkg-deb -b "$root/newer/tree" "$root/newer/broker.deb" >/dev/null
check "the upgrade installs" inside sh -c 'apt-get install -y -qq -o Dpkg::Options::=--force-confold /newer/broker.deb >/debs/log 2>&1 || { cat /debs/log; exit 1; }'
check "it keeps the administrator's configuration" grep -q 'changed by the administrator' "$root/etc/eigencast/eigencast.toml"
check "it offers the new one beside it" test -e "$root/etc/eigencast/eigencast.toml.dpkg-dist"

check "the broker is removed" inside sh -c 'apt-get remove -y -qq eigencast-broker >/debs/log 2>&1'
check "its program is gone" test ! -e "$root/usr/bin/eigencast-broker"
check "its configuration stays" test -e "$root/etc/eigencast/eigencast.toml"
check "its state stays" test -d "$root/var/lib/eigencast"
check "the broker is purged" inside sh -c 'apt-get purge -y -qq eigencast-broker >/debs/log 2>&1'
check "its configuration is gone" test ! -e "$root/etc/eigencast/eigencast.toml"
check "its state is gone" test ! -e "$root/var/lib/eigencast"
[ $failed = 0 ] && echo "packages: all as it should be"
exit $failed
