#!/usr/bin/env bash
# Instructions for one cycle of the built-in segment (all four SubDevices, MainDevice and judges), by callgrind: the
# difference of two run lengths, so that the bring-up cancels. Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "valgrind is missing: apt-get install valgrind" >&2; exit 2; }
cargo build --release --quiet
instructions() {
  valgrind --tool=callgrind --callgrind-out-file=/dev/null "${CARGO_TARGET_DIR:-target}/release/isocat" run --for "$1" 2>&1 >/dev/null |
    sed -n 's/.*Collected : //p'
}
short=$(instructions 200ms)
long=$(instructions 1200ms)
echo "instructions for bring-up and 200 cycles: $short"
echo "instructions for one cycle:               $(((long - short) / 1000))"
