#!/bin/sh
# The whole job for any CI: a shell, a Rust toolchain, no root and no network interface. Installs isocat if it is missing, checks
# the machine, and leaves the results in the folder "results" for the CI to keep.
#
# ISOCAT_SOURCE says where cargo finds isocat: "--git URL --rev COMMIT", or "--path FOLDER/crates/isocat". Name a commit: what a
# newer isocat finds is news, and no failure of this machine.
set -eu
cd "$(dirname "$0")"
if ! command -v "${ISOCAT:-isocat}" >/dev/null; then
  # The words of ISOCAT_SOURCE are arguments.
  # shellcheck disable=SC2086
  cargo install --locked --root "$PWD/.tools" ${ISOCAT_SOURCE:?says where cargo finds isocat, such as --git URL --rev COMMIT} isocat
  PATH=$PWD/.tools/bin:$PATH
fi
exec ./check.sh results
