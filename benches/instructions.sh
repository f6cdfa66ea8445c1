#!/usr/bin/env bash
# Instructions of the main paths, by callgrind, against the table in benches/instructions.txt.
#
#   benches/instructions.sh            measures, and prints each figure beside the table's
#   benches/instructions.sh --check    the same, and fails if one is more than 2 % off, to either side; with --command as well, of what the
#                                      command shows alone: programs of other packages would be compiled for minutes
#   benches/instructions.sh --update   writes the table
#
# A path that became cheaper fails the check as well: the table has to keep what was gained. Counts repeat to some 0.1 %, but hold
# for one compiler only; with another one the check ends with 77. Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."
. benches/callgrind.sh
table=benches/instructions.txt
room=2
mode=${1:-} part=${2:-}
compiler=$(rustc --version | cut -d' ' -f2)
written=$(sed -n 's/^# rustc //p' "$table")
if [ "$mode" = --check ] && [ "$compiler" != "$written" ]; then
  echo "skipped: $table holds for rustc $written, this is $compiler"
  exit 77
fi

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
printf 'cycle = "4ms"\n[[subdevice]]\ndevice = "kollmorgen_akd2g"\ncount = 100\n' >"$folder/hundred.toml"

measure() {
  cargo build --release --locked --quiet -p isocat --bins
  local program isocat=$release/isocat short long
  short=$(instructions "$isocat" run --for 0200ms) # as long as the other, see `cycle`
  long=$(instructions "$isocat" run --for 1200ms)
  echo "run.bring_up_and_200_cycles $short"
  echo "run.one_cycle $(((long - short) / 1000))"
  echo "plan.100_devices $(instructions "$isocat" plan "$folder/hundred.toml" --json)"
  # Refused at its last line, so that all of it is read and nothing more is done.
  for count in 4000 16000; do
    awk -v count=$count 'BEGIN {
      print "cycle = \"100ms\""
      for (n = 0; n < count; n++) {
        printf "[[subdevice]]\nname = \"d%d\"\ndevice = \"simple_io16\"\n", n
        if (n) printf "connect = \"%s:1\"\n", n == count - 1 ? "nobody" : "d" (n - 1)
      }
    }' >"$folder/many.toml"
    echo "file.${count}_tables $(instructions "$isocat" plan "$folder/many.toml")"
  done

  [ "$part" != --command ] || return 0
  # All at once, since what one package alone asks for is compiled again for the next one.
  program=$(cargo build --release --locked --quiet -p isocat-sim -p isocat-serve --example maindevice --example scale \
    --bench serve --message-format json | sed -n 's/.*"executable":"\([^"]*serve-[^"]*\)".*/\1/p')
  for count in 1 10 100; do
    echo "maindevice.${count}_devices $(cycle 100 1100 "$release/examples/maindevice" "$count")"
  done
  for count in 1 10 100; do
    echo "segment.${count}_devices $(cycle 2 $((count < 100 ? 102 : 12)) "$release/examples/scale" "$count")"
  done

  for part in steady pause; do
    # As a test the benchmark goes through one cycle.
    callgrind=(--toggle-collect="*linux::$part*")
    echo "serve.${part/steady/answer}_10_devices $(instructions "$program" --test '^serve/answer/10$')"
  done
}

measure >"$folder/measured"
if [ "$mode" = --update ]; then
  {
    sed -n '/^#/p' "$table" | sed "s/^# rustc .*/# rustc $compiler/"
    awk '{ printf "%-30s %12d\n", $1, $2 }' "$folder/measured"
  } >"$folder/new"
  cp "$folder/new" "$table"
fi
awk -v room="$room" -v check="$mode" -v part="$part" '
  FNR == NR { if ($0 !~ /^#/) wanted[$1] = $2; next }
  {
    found[$1] = 1
    if (!($1 in wanted)) { printf "%-30s %12d  not in the table\n", $1, $2; bad++; next }
    off = ($2 - wanted[$1]) / wanted[$1] * 100
    verdict = off > room ? "DEARER" : off < -room ? "CHEAPER: keep it, benches/instructions.sh --update" : ""
    if (verdict) bad++
    printf "%-30s %12d  table %12d  %+6.2f %%  %s\n", $1, $2, wanted[$1], off, verdict
  }
  END {
    for (name in wanted) if (!(name in found) && !(part == "--command" && name ~ /^(maindevice|segment|serve)\./)) { printf "%-30s is in the table and was not measured\n", name; bad++ }
    exit check == "--check" && bad > 0
  }' "$table" "$folder/measured" || { echo "instructions: not within $room % of $table"; exit 1; }
