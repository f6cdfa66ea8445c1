#!/usr/bin/env bash
# The real wire, measured as ratios in one run on one veth pair: answers of `isocat serve` against a bare echo on the same kind
# of socket, 100 SubDevices at 10 kHz, the processor time of an idle service, and `isocat run --interface` against SOEM (by pysoem,
# if it can be installed). Needs root and `ip`; the machine ought to be quiet. The served end has processor 1, the other one 0.
#
#   benches/wire.sh [ROUNDS]      default 3; echo and serve take turns
set -euo pipefail
cd "$(dirname "$0")/.."
rounds=${1:-3}
[ "$(id -u)" = 0 ] || { echo "benches/wire.sh makes network namespaces: run it as root" >&2; exit 77; }
command -v ip >/dev/null || { echo "ip is missing: apt-get install iproute2" >&2; exit 77; }
cargo build --release --quiet -p isocat --bins --examples
target=${CARGO_TARGET_DIR:-target}
isocat=$target/release/isocat
wire=$target/release/examples/wire
ns=isctbench
folder=$(mktemp -d)
cleanup() {
  "$isocat" control $ns-seg stop >/dev/null 2>&1 || true
  sleep 0.3
  ip netns del $ns 2>/dev/null || true
  rm -rf "$folder"
}
trap cleanup EXIT

segment() { # COUNT PROFILE
  printf 'cycle = "1ms"\n[host]\njitter = "200us"\n[[subdevice]]\ndevice = "%s"\ncount = %s\n' "$2" "$1" > "$folder/$2-$1.toml"
  echo "$folder/$2-$1.toml"
}
main() { ip netns exec $ns taskset -c 0 "$@"; }
serve() { # SEGMENT [--busy]
  taskset -c 1 "$isocat" serve "$@" --setup-veth $ns --json > "$folder/serve.json" &
  served=$!
  until grep -q serving "$folder/serve.json"; do sleep 0.1; done
  sleep 0.3
}
stop() {
  "$isocat" control $ns-seg stop > /dev/null
  wait $served || true
}
echo_on() { # [busy]
  ip netns add $ns
  ip -n $ns link add $ns type veth peer name $ns-seg
  for end in $ns $ns-seg; do
    ip netns exec $ns sysctl -qw "net.ipv6.conf.$end.disable_ipv6=1"
    ip -n $ns link set $end up
  done
  ip netns exec $ns taskset -c 1 "$wire" echo $ns-seg "$@" &
  echoing=$!
  sleep 0.3
}
echo_off() {
  kill $echoing
  wait $echoing 2>/dev/null || true
  ip netns del $ns
}
ratio() { awk -v a="$1" -v b="$2" 'BEGIN { printf "%.2f", a / b }'; }

printf '\n## Answers, 10 SubDevices (16+16 bytes), one frame a cycle at 1 kHz, us\n'
printf '| style | round | serve least / median / 99 %% | echo least / median / 99 %% | ratio least | ratio median |\n|---|---|---|---|---|---|\n'
ten=$(segment 10 simple_io16)
for style in "" busy; do
  for round in $(seq "$rounds"); do
    serve "$ten" ${style:+--busy}
    read -r _ length least median most _ _ < <(main "$wire" main $ns 1000 5000 $style)
    stop
    echo_on $style
    read -r _ _ eleast emedian emost _ _ < <(main "$wire" ping $ns 1000 5000 "$length" $style)
    echo_off
    printf '| %s | %s | %s / %s / %s | %s / %s / %s | %s | %s |\n' "${style:-sleeping}" "$round" "$least" "$median" "$most" \
      "$eleast" "$emedian" "$emost" "$(ratio "$least" "$eleast")" "$(ratio "$median" "$emedian")"
  done
done

printf '\n## 100 SubDevices (4+4 bytes) at 10 kHz for 6 s, both ends spinning: answers later than the next cycle\n'
printf '| round | serve: late of 60000 | %% | round trip least / median / 99 %% | echo: late of 60000 | %% |\n|---|---|---|---|---|---|\n'
hundred=$(segment 100 simple_io4)
for round in $(seq "$rounds"); do
  serve "$hundred" --busy
  read -r _ length least median most _ late < <(main "$wire" main $ns 100 60000 busy)
  stop
  echo_on busy
  read -r _ _ _ _ _ _ elate < <(main "$wire" ping $ns 100 60000 "$length" busy)
  echo_off
  printf '| %s | %s | %s | %s / %s / %s | %s | %s |\n' "$round" "$late" "$(ratio "$((late * 100))" 60000)" "$least" "$median" "$most" \
    "$elate" "$(ratio "$((elate * 100))" 60000)"
done

printf '\n## Processor time of an idle service, %% of one processor over 5 s\n'
serve
before=$(cut -d' ' -f1 "/proc/$served/schedstat")
sleep 5
after=$(cut -d' ' -f1 "/proc/$served/schedstat")
stop
awk -v ns=$((after - before)) 'BEGIN { printf "built-in segment, nobody sends: %.3f %%\n", ns / 5e7 }'

printf '\n## isocat run --interface: system calls of a cycle, 10 SubDevices, 10 ms (user instructions: benches/live.sh)\n'
# As the difference of a run of 2 s and one of 32 s, so that the way up is in neither figure.
tens=$(segment 10 simple_io16)
sed -i 's/cycle = "1ms"/cycle = "10ms"/; s/200us/1ms/' "$tens"
run() { # DURATION TOOL...
  local duration=$1
  shift
  serve "$tens"
  # Slowed down as it is, it may lose sync: cycles are cycles.
  ip netns exec $ns "$@" "$isocat" run "$tens" --interface $ns --for "$duration" --json > "$folder/run-$duration.json" 2> "$folder/log" || true
  stop
}
cycles() { sed -n 's/^    "cycles": \([0-9]*\).*/\1/p' "$folder/run-$1.json" | head -1; }
each() { # SHORT LONG WHAT
  awk -v a="$1" -v b="$2" -v n=$(($(cycles 32s) - $(cycles 2s))) -v what="$3" 'BEGIN { printf "%s: %.2f\n", what, (b - a) / n }'
}
if command -v strace > /dev/null; then
  calls() {
    run "$1" strace -f -c -o "$folder/strace"
    awk '$NF == "total" { print $4 }' "$folder/strace"
  }
  short=$(calls 2s); long=$(calls 32s)
  each "$short" "$long" "system calls a cycle"
else
  echo "system calls: skipped, strace is missing (apt-get install strace)"
fi

printf '\n## Round trip of all frames of a cycle, 100 SubDevices (16+16 bytes), 1 kHz, against the same service, us\n'
python=$folder/venv/bin/python
if python3 -m venv "$folder/venv" 2>/dev/null && "$folder/venv/bin/pip" -q install "pysoem==1.1.13" 2>/dev/null; then
  printf '| round | isocat least / median | SOEM (pysoem) least / median | ratio least | ratio median |\n|---|---|---|---|---|\n'
  many=$(segment 100 simple_io16)
  for round in $(seq "$rounds"); do
    serve "$many"
    read -r frames _ least median _ _ _ < <(main "$wire" main $ns 1000 4000)
    stop
    serve "$many"
    read -r sleast smedian < <(main "$python" benches/soem_round_trip.py $ns 4000)
    stop
    printf '| %s | %s / %s | %s / %s | %s | %s |\n' "$round" "$least" "$median" "$sleast" "$smedian" \
      "$(ratio "$least" "$sleast")" "$(ratio "$median" "$smedian")"
  done
  echo "isocat: $frames frames a cycle"
else
  echo "skipped: pysoem can't be installed"
fi
