#!/usr/bin/env bash
# What needs root, network interfaces and the machine's clock: the tests of real wires (crates/isocat/tests/wire), each on veth pairs in
# a network namespace that it makes itself, and those tests beside the code that are marked with what they need. Takes names of tests.
# Exit 77: not root, or no `ip`; 75: nothing failed, but this machine stalled too much for some of them to tell, which are listed.
set -euo pipefail
cd "$(dirname "$0")/.."
[ "$(id -u)" = 0 ] || { echo "wire: skipped, missing: root"; exit 77; }
command -v ip >/dev/null || { echo "wire: skipped, missing: ip (iproute2)"; exit 77; }
# Each test that can't be judged here says so in this file; one that passes for want of evidence would look like one that passed.
ISOCAT_NOT_SHOWN=$(mktemp)
export ISOCAT_NOT_SHOWN
trap 'rm -f "$ISOCAT_NOT_SHOWN"' EXIT
# Of all packages, as `cargo test` has compiled them: with `-p` their dependencies would be compiled again, with fewer features.
cargo test --quiet --locked --lib -- --ignored "$@"
cargo test --locked --test wire -- "$@"
[ ! -s "$ISOCAT_NOT_SHOWN" ] || {
  printf '\nNOT SHOWN here: %d\n' "$(wc -l <"$ISOCAT_NOT_SHOWN")"
  sed 's/^/  - /' "$ISOCAT_NOT_SHOWN"
  # Root and `ip` are there, so nothing may be skipped for want of them.
  ! grep -q 'skipped: ' "$ISOCAT_NOT_SHOWN" || exit 1
  exit 75
}
