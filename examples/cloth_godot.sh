#!/bin/sh
# SPDX-License-Identifier: MIT
# Streams what Godot computes, through a pipe: cloth_godot.sh http://127.0.0.1:7490/cloth
here=$(dirname "$0")
mesh=$(mktemp --suffix .obj)
trap 'rm -f "$mesh"' EXIT
godot3-server -s "$here/cloth_godot.gd" mesh | grep '^[vf] ' >"$mesh"
stdbuf -oL godot3-server -s "$here/cloth_godot.gd" |
  perl -ne 'BEGIN { $| = 1 } print pack("f<*", split) if s/^pose //' |
  eigencast-sender pipe --mesh "$mesh" --rate 30 --to "$1"
