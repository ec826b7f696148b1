#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Shows a deforming surface streamed from a sender through a broker to a viewer, all on this machine.
#   deploy/demo.sh                 builds, then opens a window; Ctrl-C, or closing the window, ends all of it
#   deploy/demo.sh --headless      the same without a display: PNG pictures and report.json in the output folder
# Options:
#   --shape NAME|PATH   what to stream: heart (default), bar, bar:twist, bar:bend, torus, sphere, or a model or clip of your own
#   --out DIR           where pictures and the report go (default: out/demo)
#   --frames N          pictures to write when headless (default: 90)
#   --lod L             level of detail of the viewer, 0..1 (default: 1)
#   --programs DIR      the folder of programs that are built already (default: builds them)
set -euo pipefail
cd "$(dirname "$0")/.."

headless=0 shape=heart out=out/demo frames=90 lod=1 programs=
usage() { sed -n '3,11s/^# \{0,1\}//p' deploy/demo.sh; }
while [ $# -gt 0 ]; do
  case "$1" in
    --headless) headless=1 ;;
    --shape|--out|--frames|--lod|--programs)
      [ $# -ge 2 ] || { echo "demo: $1 needs a value" >&2; exit 2; }
      declare "${1#--}=$2"; shift ;;
    -h|--help) usage; exit 0 ;;
    *) echo "demo: unknown option '$1'" >&2; usage >&2; exit 2 ;;
  esac
  shift
done
if [ $headless = 0 ] && [ -z "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ]; then
  echo "demo: there is no display here, so this goes headless; pictures will be in $out"
  headless=1
fi

# Passes on how far ninja is: on a terminal one line that counts, elsewhere a line for each tenth.
show_progress() {
  local line shown=-1
  while IFS= read -r line; do
    [[ $line =~ ^\[([0-9]+)/([0-9]+)\] ]] || continue
    if [ -t 1 ]; then
      printf '\r  %s of %s steps' "${BASH_REMATCH[1]}" "${BASH_REMATCH[2]}"
    elif [ $((10 * BASH_REMATCH[1] / BASH_REMATCH[2])) -ne $shown ]; then
      shown=$((10 * BASH_REMATCH[1] / BASH_REMATCH[2]))
      echo "  ${BASH_REMATCH[1]} of ${BASH_REMATCH[2]} steps"
    fi
  done
  [ ! -t 1 ] || printf '\r\033[K'
}
if [ -z "$programs" ]; then
  deploy/install-packages.sh demo
  build=build/release
  mkdir -p build
  echo "building: the first time takes about 5 minutes on two cores (log: build/demo-build.log)"
  { cmake --preset release -DEIGENCAST_BUILD_TESTS=OFF && cmake --build --preset release --target eigencast-broker eigencast-sender eigencast-client eigencast-compare; } 2>&1 |
    tee build/demo-build.log | show_progress ||
    { tail -n 40 build/demo-build.log; echo "demo: the build failed; the whole log is build/demo-build.log" >&2; exit 1; }
  programs=$build/bin
fi

mkdir -p "$out"
rm -f "$out"/frame_*.png "$out"/report.json "$out"/*.log "$out"/*.jsonl
work=$(mktemp -d)
broker_pid='' sender_pid='' client_pid=''
finish() {
  status=$?
  trap - EXIT INT TERM
  for pid in $client_pid $sender_pid $broker_pid; do kill -TERM "$pid" 2>/dev/null || true; done
  for pid in $client_pid $sender_pid $broker_pid; do wait "$pid" 2>/dev/null || true; done
  rm -rf "$work"
  exit "$status"
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

"$programs/eigencast-broker" --listen 127.0.0.1:0 --port-file "$work/port" --data-dir "$work/assets" --history-streams "**" >"$out/broker.log" 2>&1 &
broker_pid=$!
until [ -s "$work/port" ]; do
  kill -0 $broker_pid 2>/dev/null || { cat "$out/broker.log"; echo "demo: the broker did not start" >&2; exit 1; }
  sleep 0.05
done
url="http://127.0.0.1:$(cat "$work/port")/demo"

# The bake shows its progress here; play then starts at once from the cache.
"$programs/eigencast-sender" bake "$shape"
"$programs/eigencast-sender" play "$shape" --to "$url" --record "$out/sent.jsonl" >"$out/sender.log" 2>&1 &
sender_pid=$!
echo "streaming $shape at $url"
page=$(sed -n 's/.*, page at //p' "$out/broker.log")
[ -z "$page" ] || echo "in a browser: ${page}demo"

if [ $headless = 0 ]; then
  echo "more viewers: $programs/eigencast-client $url"
  "$programs/eigencast-client" "$url" --lod "$lod" &
  client_pid=$!
  wait $client_pid
else
  "$programs/eigencast-client" "$url" --headless --frames "$frames" --out "$out" --lod "$lod" --json "$out/report.json" \
    --record "$out/received.jsonl" >"$out/client.log" 2>&1 &
  client_pid=$!
  wait $client_pid || { tail -n 5 "$out/client.log" "$out/sender.log" "$out/broker.log"; echo "demo: the viewer failed" >&2; exit 1; }
  kill -INT $sender_pid; wait $sender_pid || true
  sender_pid=''
  "$programs/eigencast-compare" "$shape" --sent "$out/sent.jsonl" --received "$out/received.jsonl" --report "$out/report.json"
  rm -f "$out"/sent.jsonl "$out"/received.jsonl
  echo "pictures: $out/frame_*.png   report: $out/report.json"
fi
