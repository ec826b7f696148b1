#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Builds everything and runs all tests; installs what is missing first. Ends with ctest's closing line.
#   tests/run.sh          the tier of at most 20 minutes on two cores
#   tests/run.sh --full   AddressSanitizer with UBSan, ThreadSanitizer, and the same with what is labelled full: soak, brokers on hosts of
#                         their own, Debian packages on machines with systemd (these want root; what they miss is named, and they are skipped)
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

deploy/install-packages.sh
if [ $full = 1 ]; then
  # Servers that would start by themselves are installed by no script.
  for tool in ip nats-server nginx promtool mmdebstrap systemd-nspawn lintian; do
    command -v "$tool" >/dev/null || echo "tests/run.sh: $tool is not here; tests that need it will be skipped" >&2
  done
  deploy/packages.sh
fi
presets=(ci)
[ $full = 0 ] || presets=(asan tsan ci)
for preset in "${presets[@]}"; do
  cmake --preset "$preset" >"${TMPDIR:-/tmp}/eigencast-configure.$$" 2>&1 || { cat "${TMPDIR:-/tmp}/eigencast-configure.$$"; exit 1; }
  rm -f "${TMPDIR:-/tmp}/eigencast-configure.$$"
  cmake --build --preset "$preset"
  if [ $full = 1 ] && [ "$preset" = ci ]; then ctest --preset ci; else ctest --preset "$preset" -LE full; fi
done
