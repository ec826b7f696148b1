#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Installs what is missing, builds everything and runs all tests. Ends with the skipped tests by reason, and a count of all.
#   tests/run.sh          the tier of at most 12 minutes on two cores
#   tests/run.sh --full   AddressSanitizer with UBSan, ThreadSanitizer, the normal tier with what is labelled full (soak, faults of a cluster,
#                         a long clip, Debian packages on machines with systemd, hosts), the corpora of the fuzz targets, the
#                         benchmarks (built only), and clang-tidy
set -euo pipefail
cd "$(dirname "$0")/.."

full=0
for argument in "$@"; do
  case "$argument" in
    --full) full=1 ;;
    -h|--help) sed -n '3,7s/^# \{0,1\}//p' "$0"; exit 0 ;;
    *) echo "tests/run.sh: unknown argument '$argument'; see --help" >&2; exit 2 ;;
  esac
done

build() {
  local log
  log=$(mktemp)
  cmake --preset "$1" >"$log" 2>&1 || { cat "$log"; rm "$log"; exit 1; }
  rm "$log"
  cmake --build --preset "$@"
}
reports=() failed=0
run_tests() {  # PRESET [options of ctest]
  reports+=("build/$1/tests.xml")
  ctest --preset "$1" --output-junit tests.xml --test-output-size-passed 1000000 "${@:2}" || failed=1
}

if [ $full = 0 ]; then
  deploy/install-packages.sh tests
  build ci
  run_tests ci -LE full
else
  deploy/install-packages.sh full
  deploy/packages.sh
  for preset in asan tsan; do
    build $preset
    run_tests $preset -LE full
  done
  build ci
  run_tests ci
  build fuzz --target fuzzers
  run_tests fuzz -L fuzz
  build bench || failed=1
  build tidy || failed=1
fi
python3 tests/support/summary.py "${reports[@]}"
exit $failed
