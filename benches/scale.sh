#!/usr/bin/env bash
# Instructions of one SubDevice and cycle (by callgrind) and bytes of one SubDevice, on lines of 1 to 10 000 SubDevices with 16
# bytes each way; then the same with a MainDevice. Usage: benches/scale.sh [N...]. Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
. benches/callgrind.sh
cargo build --release --quiet -p isocat-sim --example scale
for n in "${@:-1 10 100 1000 10000}"; do for count in $n; do
  "$release/examples/scale" "$count" $((count < 5000 ? 100000 / count : 20))
  echo "  $(($(cycle 2 $((count < 100 ? 102 : 12)) "$release/examples/scale" "$count") / count)) instructions"
done; done
