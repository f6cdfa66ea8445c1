#!/bin/sh
# Checks the machine: its plan, its run with faults and expectations, and the same run with other crystals and a busier host.
# All steps run, so that the results are whole; the exit code is the worst one: 0 as expected, 1 not, 2 bad input.
#
#   ./check.sh [RESULTS]      files go to the folder RESULTS (without it: results)
#
# ISOCAT names the program (without it: isocat), SEEDS how many seeds the sweep tries at each point (without it: 25).
set -u
cd "$(dirname "$0")" || exit 2
results=${1:-results}
isocat=${ISOCAT:-isocat}
mkdir -p "$results" || exit 2
# A sweep does not overwrite the rows of an earlier one.
rm -rf "$results/sweep.csv" "$results/failed"
worst=0

step() { # NAME COMMAND...
  printf '\n== %s\n' "$1"
  shift
  "$@"
  code=$?
  [ "$code" -le "$worst" ] || worst=$code
}

plan() { "$isocat" plan machine.toml >"$results/plan.txt"; code=$?; head -n 3 "$results/plan.txt"; return "$code"; }
step "plan: does the cycle fit" plan
step "run: what goes wrong, and what is expected all the same" \
  "$isocat" run machine.toml --junit "$results/junit.xml" --report "$results/run.html"
step "sweep: other crystals, a busier host" \
  "$isocat" sweep machine.toml --seeds "${SEEDS:-25}" --vary host.jitter=5us,50us \
  --rows "$results/sweep.csv" --page "$results/sweep.html" --failed "$results/failed" --shrink

printf '\nexit code %s; results are in %s\n' "$worst" "$results"
exit "$worst"
