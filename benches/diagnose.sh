#!/usr/bin/env bash
# How long `isocat diagnose` takes for a capture of some 200 000 frames, and how long `tshark -T fields` with the same registers does: processor
# time of both in turn, three times, the least of each and their ratio.
# Usage: benches/diagnose.sh [ISOCAT]; without it the release build is used. Exit 77: something is missing.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v tshark >/dev/null || { echo "skipped, missing: tshark"; exit 77; }
isocat=${1:-}
if [ -z "$isocat" ]; then
  cargo build --release --locked --quiet
  isocat=${CARGO_TARGET_DIR:-target}/release/isocat
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$isocat" run --for 10s --capture "$folder/one.pcapng" >/dev/null
for _ in 1 2 3 4 5 6 7 8 9 10; do cat "$folder/one.pcapng"; done >"$folder/ten.pcapng"
fields=(-e frame.number -e ecat.cmd -e ecat.adp -e ecat.ado -e ecat.cnt -e ecat.data)
seconds() { # COMMAND...: processor time
  local TIMEFORMAT='%U %S'
  { time "$@" >"$folder/out" 2>/dev/null; } 2>&1 | awk '{ print $1 + $2 }'
}
for turn in 1 2 3; do
  echo "$(seconds "$isocat" diagnose "$folder/ten.pcapng") $(seconds tshark -r "$folder/ten.pcapng" -T fields "${fields[@]}")"
done | tee "$folder/turns" | awk '{ printf "isocat diagnose %s s, tshark %s s\n", $1, $2 }'
frames=$("$isocat" diagnose "$folder/ten.pcapng" --json | grep -o '"packets": *[0-9]*' | head -1 | grep -o '[0-9]*$')
awk -v frames="$frames" 'NR == 1 || $1 < one { one = $1 } NR == 1 || $2 < other { other = $2 }
  END { printf "%d frames: %.2f million a second, %.0f times as fast as tshark\n", frames, frames / one / 1e6, other / one }' "$folder/turns"
