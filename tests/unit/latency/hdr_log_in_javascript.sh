#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# hdr_log_in_javascript.sh SAMPLE: hdr-histogram-js decodes what our log writer wrote. 77: the module is not on this machine.
set -euo pipefail
sample=$1
here=$(cd "$(dirname "$0")" && pwd)
export NODE_PATH=${NODE_PATH:-$here/../../../build/tools/node/node_modules}
node -e "require.resolve('hdr-histogram-js')" 2>/dev/null || {
  echo "SKIPPED: no hdr-histogram-js; deploy/install-packages.sh fetches it with npm"
  exit 77
}
"$sample" | node "$here/hdr_log_reader.js"
