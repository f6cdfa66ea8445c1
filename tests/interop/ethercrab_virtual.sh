#!/usr/bin/env bash
# ethercrab, unmodified, in cargo test and in virtual time: tests/interop/ethercrab-virtual, and docs/examples/ethercrab-in-cargo-test as
# its reader runs it. Both have lock files of their own, so that the main build does not depend on ethercrab. Exit 77: what they
# need can't be had.
set -euo pipefail
cd "$(dirname "$0")/../.."
export CARGO_TARGET_DIR=$PWD/target/ethercrab-virtual
# Lines for backtraces and optimization between the parts of a crate, which the reader has, take half of the time to compile.
export CARGO_PROFILE_DEV_DEBUG=false CARGO_PROFILE_DEV_LTO=off CARGO_PROFILE_DEV_OPT_LEVEL=0
# So does optimization of what no frame goes through.
fast=()
for package in wire sync esc subdevice maindevice sim; do fast+=(--config "profile.dev.package.isocat-$package.opt-level=1"); done
tests=tests/interop/ethercrab-virtual example=docs/examples/ethercrab-in-cargo-test
for folder in $tests $example; do
  (cd $folder && cargo fetch --quiet --locked) || { echo "ethercrab_virtual: skipped, missing: ethercrab and what it depends on"; exit 77; }
  (cd $folder && cargo fmt --check)
done
(cd $tests && cargo "${fast[@]}" test --quiet --locked)
# The same program built for production in the same folder, and its tests by the reader's command.
(cd $example && cargo "${fast[@]}" virtual --quiet --locked && cargo "${fast[@]}" build --quiet --locked)
# An ethercrab that waits for the machine's clock is told, and is no hang.
(cd $tests && cargo "${fast[@]}" test --quiet --locked --features std --test std_is_told)
