#!/usr/bin/env bash
# How fast makers' descriptions (ESI) are imported: all files of the folders that are named, five times over in one process, reading
# them from disk included. Without folders those beside the project. With --callgrind FILE: where the instructions of one file
# go (needs valgrind).
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet -p isocat-descriptions --example import
program=${CARGO_TARGET_DIR:-target}/release/examples/import
if [ "${1:-}" = --callgrind ]; then
  out=$(mktemp)
  valgrind --tool=callgrind --callgrind-out-file="$out" "$program" "$2"
  callgrind_annotate "$out" | head -40
  rm -f "$out"
  exit
fi
[ $# -gt 0 ] || set -- ../shared/esi ../shared/esi-more
for path; do
  [ -e "$path" ] || { echo "skipped: no $path" >&2; exit 0; }
done
TIMEFORMAT='%R %U %S'
{ times=$( { time "$program" "$@" "$@" "$@" "$@" "$@" >&3; } 2>&1 ); } 3>/tmp/isocat-import.$$
trap 'rm -f /tmp/isocat-import.$$' EXIT
cat /tmp/isocat-import.$$
read -r wall user system <<<"$times"
bytes=$(sed 's/.* files, \([0-9]*\) bytes.*/\1/' /tmp/isocat-import.$$)
awk -v b="$bytes" -v w="$wall" -v u="$user" -v s="$system" 'BEGIN {
  printf "wall %.2f s, %.1f MB/s; processor %.2f s, %.1f MB/s\n", w, b / w / 1e6, u + s, b / (u + s) / 1e6
}'
