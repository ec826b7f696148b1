#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# hdr_log_in_javascript.sh SAMPLE FOLDER: hdr-histogram-js decodes what our log writer wrote. 77: npm could not fetch it.
set -euo pipefail
sample=$1 folder=$2
here=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$folder"
if [ ! -d "$folder/node_modules/hdr-histogram-js" ]; then
  npm install --prefix "$folder" --no-audit --no-fund --silent hdr-histogram-js@3.0.1 >"$folder/npm.log" 2>&1 ||
    { echo "SKIPPED: npm could not fetch hdr-histogram-js (see $folder/npm.log): the log format is not checked against it"; exit 77; }
fi
"$sample" >"$folder/sample.txt"
NODE_PATH="$folder/node_modules" node "$here/hdr_log_reader.js" "$folder/sample.txt"
