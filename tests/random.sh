#!/usr/bin/env bash
# Tests with random inputs, with inputs that nobody has seen; `cargo test` draws the same 500 for each test every time.
#
#   tests/random.sh [CASES] [SEED]   by default 20 000 for each test, and a seed from the clock, which is printed
set -euo pipefail
cd "$(dirname "$0")/.."
export PROPTEST_CASES=${1:-20000} PROPTEST_RNG_SEED=${2:-$(date +%s)}
names=$(grep -rl --include='*.rs' '^ *proptest! {' crates | xargs awk '
  FNR == 1 { inside = 0 }
  /proptest! \{/ { inside = 1 }
  inside && $1 == "fn" && previous ~ /#\[test\]/ { sub(/\(.*/, "", $2); print $2 }
  { previous = $0 }')
echo "$(wc -l <<<"$names") tests, $PROPTEST_CASES cases each, seed $PROPTEST_RNG_SEED"
# Without the modules' names: a name of a test is in no other test's name.
# shellcheck disable=SC2086 # several names
cargo test --locked --quiet --lib --test anything -- $names 2>&1 | grep -v '^running 0\|^test result: ok. 0 passed\|^$' ||
  { echo "again: tests/random.sh $PROPTEST_CASES $PROPTEST_RNG_SEED"; exit 1; }
