#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Installs what is missing, builds, and runs every test. Short where all is well; on failure the
# whole output of what failed.
#   ./test.sh               release build
#   ./test.sh --sanitize    AddressSanitizer and UndefinedBehaviorSanitizer
#   further arguments go to cmake's configure step, such as -DLUMIVDB_WARNINGS_AS_ERRORS=ON
set -euo pipefail
cd "$(dirname "$0")"

preset=release
if [ "${1:-}" = --sanitize ]; then
    preset=asan-ubsan
    shift
fi

./install_packages.sh tests
log=$(mktemp)
trap 'rm -f "$log"' EXIT
quietly() { # shows the output only when the command fails
    echo "$*"
    "$@" >"$log" 2>&1 || { cat "$log"; exit 1; }
}
quietly cmake --preset "$preset" "$@"
quietly cmake --build --preset "$preset"
echo "ctest --preset $preset"
ctest --preset "$preset" --parallel "$(nproc)" --quiet --output-log "$log" || { cat "$log"; exit 1; }
grep -A3 -E "tests passed" "$log"
