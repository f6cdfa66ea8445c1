#!/usr/bin/env bash
# User instructions that one cycle in operation costs the loop of `isocat run --interface`, by callgrind, on lines of N simple_io16
# (16 bytes each way). `isocat serve` is at the other end of a veth pair in a network namespace of its own.
#
# Collected is what runs inside of `Running::operate`, and of it the difference of a short run and a long one. What only waits is
# left out: how often the clock is read until the instant has come says nothing. Of the rest three parts are told: the application
# that writes all outputs; the procedures of the background, which read clocks and counters of the SubDevices in a share of the
# wire, so that they cost less in each of shorter cycles; and the clock servo.
#
# Callgrind has no vDSO, so a reading of the clock counts as a call of libc without the kernel's code. It slows the loop some
# fifty times, hence the cycle of 4 ms; a few late cycles do no harm.
#
# Usage: [CYCLE=4ms] [JITTER=500us] benches/live.sh [N...], default 1 10 100. The jitter is below half a cycle. Needs root, iproute2 and valgrind; some 30 s for each N.
set -euo pipefail
cd "$(dirname "$0")/.."
[ "$(id -u)" = 0 ] || { echo "benches/live.sh makes a network namespace: run it as root" >&2; exit 77; }
for tool in ip valgrind callgrind_annotate; do
  command -v $tool >/dev/null || { echo "$tool is missing: apt-get install iproute2 valgrind" >&2; exit 77; }
done
# With names: the parts are found by them. The code is that of a release.
cargo build --profile bench --quiet -p isocat --bins
isocat=${CARGO_TARGET_DIR:-target}/release/isocat
cycle=${CYCLE:-4ms} jitter=${JITTER:-500us} short=2s long=10s
ns=isctlive
folder=$(mktemp -d)
cleanup() {
  "$isocat" control $ns-seg stop >/dev/null 2>&1 || true
  sleep 0.3
  ip netns del $ns 2>/dev/null || true
  rm -rf "$folder"
}
trap cleanup EXIT

run() { # DURATION: callgrind's file of a run, and its report
  "$isocat" serve "$folder/segment.toml" --setup-veth $ns --json >"$folder/serve.json" &
  served=$!
  until grep -q serving "$folder/serve.json"; do sleep 0.1; done
  sleep 0.3
  # Slowed down as it is, it may lose sync: cycles are cycles.
  ip netns exec $ns valgrind --tool=callgrind --toggle-collect='*job::Running::operate' \
    --callgrind-out-file="$folder/callgrind-$1" \
    "$isocat" run "$folder/segment.toml" --interface $ns --for "$1" --json >"$folder/run-$1.json" 2>"$folder/log" || true
  "$isocat" control $ns-seg stop >/dev/null
  wait $served || true
}
number() { sed -n "s/^    \"$2\": \([0-9]*\).*/\1/p" "$folder/run-$1.json" | head -1; }
total() { sed -n 's/^totals: //p' "$folder/callgrind-$1"; }
part() { # DURATION FUNCTION: instructions of it and of what it calls
  callgrind_annotate --threshold=100 --inclusive=yes "$folder/callgrind-$1" 2>/dev/null |
    awk -v name="$2" 'index($0, name) { gsub(",", "", $1); print $1; found = 1; exit } END { if (!found) print 0 }'
}
each() { echo $((($2 - $1) / cycles)); }
of() { each "$(part $short "$1")" "$(part $long "$1")"; }

for n in ${*:-1 10 100}; do
  printf 'cycle = "%s"\n[host]\njitter = "%s"\n[[subdevice]]\ndevice = "simple_io16"\ncount = %s\n' "$cycle" "$jitter" "$n" >"$folder/segment.toml"
  for duration in $short $long; do run $duration; done
  cycles=$(($(number $long cycles) - $(number $short cycles)))
  spin=$(of link::spin)
  all=$(($(each "$(total $short)" "$(total $long)") - spin))
  application=$(of 'Motion as isocat_maindevice::application::Application>::cycle')
  background=$(of '::work_on_all')
  servo=$(of Servo::sample)
  echo "$n SubDevices: $all instructions a cycle of $cycle: application $application, background $background, servo $servo," \
    "the loop with the MainDevice $((all - application - background - servo)); and $spin to wait ($cycles cycles)"
done
