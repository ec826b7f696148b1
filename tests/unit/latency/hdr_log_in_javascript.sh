#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# hdr_log_in_javascript.sh SAMPLE: hdr-histogram-js decodes what our log writer wrote. 77: the module is not on this machine.
# To run it: npm install --prefix FOLDER hdr-histogram-js@3.0.1, then NODE_PATH=FOLDER/node_modules ctest -R hdr_log.
set -euo pipefail
sample=$1
here=$(cd "$(dirname "$0")" && pwd)
node -e "require.resolve('hdr-histogram-js')" 2>/dev/null || {
  echo "SKIPPED: node finds no hdr-histogram-js through NODE_PATH: the log format is NOT checked against it"
  exit 77
}
"$sample" | node "$here/hdr_log_reader.js"
