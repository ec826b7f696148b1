#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The systemd units: no complaint from systemd-analyze, and an exposure of at most 1.7. Exit 77: systemd-analyze is not here.
#   tests/packages/units_test.sh PATH_OF_BROKER
set -euo pipefail
broker=$(realpath "${1:?usage: units_test.sh PATH_OF_BROKER}")
cd "$(dirname "$0")/../../deploy/systemd"
command -v systemd-analyze >/dev/null || { echo "SKIPPED: systemd-analyze is not installed"; exit 77; }

units=$(mktemp -d)
trap 'rm -rf "$units"' EXIT
for unit in *; do sed "s#/usr/bin/eigencast-broker#$broker#; /^Documentation=/d" "$unit" >"$units/$unit"; done
complaints=$(systemd-analyze verify --man=no "$units"/*.service "$units"/*.socket 2>&1 | grep -F "$units" || true)
[ -z "$complaints" ] || { echo "$complaints"; exit 1; }
systemd-analyze security --offline=true --threshold=17 --no-pager "$units/eigencast-broker.service" | tail -n 1
