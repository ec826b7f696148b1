#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Runs both examples against a real broker: run_test.sh BROKER PUBLISH SUBSCRIBE
set -euo pipefail
broker=$1 publish=$2 subscribe=$3
work=$(mktemp -d)
export EIGENCAST_CACHE=$work/cache
trap 'kill $(jobs -p) 2>/dev/null; wait; rm -rf "$work"' EXIT

"$broker" --listen 127.0.0.1:0 --port-file "$work/port" --data-dir "$work/assets" >"$work/broker.log" 2>&1 &
for _ in $(seq 200); do [ -s "$work/port" ] && break; sleep 0.05; done
url=ws://127.0.0.1:$(cat "$work/port")/sheet

"$publish" "$url" 60 >"$work/publish.log" 2>&1 &
"$subscribe" "$url" 90 | tee "$work/subscribe.log" || { cat "$work"/*.log; exit 1; }
grep -qE 'received [1-9][0-9]* keys and [1-9][0-9]* interpolated poses' "$work/subscribe.log"
grep -qE 'key [0-9]+.*: 1800 vertices' "$work/subscribe.log"
