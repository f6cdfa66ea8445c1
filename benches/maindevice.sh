#!/usr/bin/env bash
# Instructions that one cycle costs the MainDevice alone (time-out, frames out, frames in, the call of an empty application, events),
# by callgrind, on lines of N SubDevices with 16 bytes each way. The frames are answered by patching copies, see
# crates/sim/examples/maindevice.rs; that is in the figure, with about 15 instructions for each datagram.
# Usage: benches/maindevice.sh [N...]. Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
. benches/callgrind.sh
cargo build --release --quiet -p isocat-sim --example maindevice
for n in "${@:-1 10 100}"; do for count in $n; do
  echo "$count SubDevices: $(cycle 100 1100 "$release/examples/maindevice" "$count") instructions a cycle"
done; done
