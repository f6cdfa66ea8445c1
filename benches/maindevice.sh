#!/usr/bin/env bash
# Instructions that one cycle costs the MainDevice alone (time-out, frames out, frames in, the call of an empty application, events), by callgrind as the
# difference of two run lengths, on lines of N SubDevices with 16 bytes each way. The frames are answered by patching
# copies, see crates/sim/examples/maindevice.rs; that is in the figure, with about 15 instructions for each datagram.
# Usage: benches/maindevice.sh [N...]. Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "valgrind is missing: apt-get install valgrind" >&2; exit 2; }
cargo build --release --quiet -p isocat-sim --example maindevice
maindevice="${CARGO_TARGET_DIR:-target}/release/examples/maindevice"
instructions() {
  valgrind --tool=callgrind --callgrind-out-file=/dev/null "$maindevice" "$@" 2>&1 >/dev/null | sed -n 's/.*Collected : //p'
}
for n in "${@:-1 10 100}"; do for count in $n; do
  short=$(instructions "$count" 100)
  long=$(instructions "$count" 1100)
  echo "$count SubDevices: $(((long - short) / 1000)) instructions a cycle"
done; done
