#!/usr/bin/env bash
# Runs every numbered example. Those that take a network interface run at a served segment too, in a namespace made for it: without
# root or `ip` that part is left out, with a word. An example fails by its exit code or by printing nothing.
set -euo pipefail
cd "$(dirname "$0")/../.."
# Of all packages, as `cargo test` has compiled them: with `-p` their dependencies would be compiled again, with fewer features.
cargo build --quiet --locked --bins --examples
target=${CARGO_TARGET_DIR:-target}/debug

run() { # NAME COMMAND...
  local name=$1 printed
  shift
  printed=$("$@") || { printf '%s failed: %s\n' "$name" "$*"; exit 1; }
  [ -n "$printed" ] || { printf '%s prints nothing\n' "$name"; exit 1; }
  printf '%s: %s\n' "$name" "$(tail -n 1 <<<"$printed")"
}

count=0
for file in crates/*/examples/[0-9][0-9]_*.rs; do
  name=$(basename "$file" .rs)
  count=$((count + 1))
  # The interface is all that this one is about.
  [ "$name" = 03_own_interface ] || run "$name" "$target/examples/$name"
done
# As many as their numbers say.
last=$(ls crates/*/examples/[0-9][0-9]_*.rs | sed 's#.*/##' | sort | tail -n 1)
[ "$count" -eq "$((10#${last%%_*}))" ] || { printf '%d examples, the last is %s\n' "$count" "$last"; exit 1; }

if [ "$(id -u)" -ne 0 ] || ! command -v ip >/dev/null; then
  echo "examples on an interface: left out, they need root and ip"
  exit 0
fi
# At most eleven characters: the interfaces are named after it.
namespace=examples
segment=$(mktemp --suffix=.toml)
log=$(mktemp)
printf 'cycle = "2ms"\n[[subdevice]]\ndevice = "simple_io16"\ncount = 2\n[[subdevice]]\ndevice = "kollmorgen_akd2g"\n' >"$segment"
"$target/isocat" serve "$segment" --setup-veth "$namespace" >"$log" 2>&1 &
server=$!
finish() {
  kill -INT "$server" 2>/dev/null || true
  wait "$server" 2>/dev/null || true
  rm -f "$segment" "$log"
}
trap finish EXIT
command=
for _ in $(seq 100); do
  command=$(sed -n 's/^Your MainDevice: \(ip netns exec [^ ]*\) PROGRAM \(.*\)$/\1 \2/p' "$log")
  [ -z "$command" ] || break
  kill -0 "$server" || { cat "$log"; exit 1; }
  sleep 0.1
done
[ -n "$command" ] || { echo "the segment is not served:"; cat "$log"; exit 1; }
interface=${command##* }
for name in 02_application 03_own_interface; do
  run "$name on an interface" ${command% *} "$target/examples/$name" "$interface"
done
