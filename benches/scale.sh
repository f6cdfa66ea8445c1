#!/usr/bin/env bash
# Instructions of one SubDevice and cycle (by callgrind, as the difference of two run lengths, so that the way up cancels)
# and bytes of one SubDevice, on lines of 1 to 10 000 SubDevices with 16 bytes each way; then the same with a MainDevice.
# Usage: benches/scale.sh [N...]. Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "valgrind is missing: apt-get install valgrind" >&2; exit 2; }
cargo build --release --quiet -p isocat-sim --example scale
scale="${CARGO_TARGET_DIR:-target}/release/examples/scale"
instructions() {
  valgrind --tool=callgrind --callgrind-out-file=/dev/null "$scale" "$@" 2>&1 >/dev/null | sed -n 's/.*Collected : //p'
}
for n in "${@:-1 10 100 1000 10000}"; do for count in $n; do
  "$scale" "$count" $((count < 5000 ? 100000 / count : 20))
  short=$(instructions "$count" 2)
  long=$(instructions "$count" 12)
  echo "  $(((long - short) / 10 / count)) instructions"
done; done
