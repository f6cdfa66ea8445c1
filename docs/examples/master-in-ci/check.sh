#!/bin/sh
# Tries the MainDevice, as it is, in virtual time: once with what the segment file expects, then with other crystals and other bad
# luck of its computer. No network interface, no root, and a busy machine makes no difference.
#
#   ./check.sh [RESULTS]      files go to the folder RESULTS (without it: results)
#
# MASTER is what starts the MainDevice; ISOCAT names isocat (without it: isocat), SEEDS how many seeds are tried.
set -u
cd "$(dirname "$0")" || exit 2
results=${1:-results}
isocat=${ISOCAT:-isocat}
# Your program stands here: ./my_master vt0
master=${MASTER:-.venv/bin/python3 master.py vt0}
mkdir -p "$results" || exit 2
worst=0

step() { # NAME COMMAND...
  printf '\n== %s\n' "$1"
  shift
  "$@"
  code=$?
  [ "$code" -le "$worst" ] || worst=$code
}

# The words of it are a command and its arguments.
# shellcheck disable=SC2086
step "once: what goes wrong, and what is expected all the same" \
  "$isocat" virtual master.toml --junit "$results/junit.xml" --report "$results/run.html" -- $master
# shellcheck disable=SC2086
step "many times: other crystals, other bad luck" \
  "$isocat" virtual master.toml --seeds "${SEEDS:-10}" --rows "$results/seeds.csv" --failed "$results/failed" \
  -- $master

printf '\nexit code %s; results are in %s\n' "$worst" "$results"
exit "$worst"
