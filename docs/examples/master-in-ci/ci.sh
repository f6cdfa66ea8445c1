#!/bin/sh
# The whole job for any CI: a shell, a Rust toolchain, Python. Installs isocat and what the MainDevice needs if they are missing, and
# leaves the results in the folder "results" for the CI to keep.
#
# ISOCAT_SOURCE says where cargo finds isocat: "--git URL --rev COMMIT", or "--path FOLDER/crates/isocat".
set -eu
cd "$(dirname "$0")"
if ! command -v "${ISOCAT:-isocat}" >/dev/null; then
  # The words of ISOCAT_SOURCE are arguments.
  # shellcheck disable=SC2086
  cargo install --locked --root "$PWD/.tools" ${ISOCAT_SOURCE:?says where cargo finds isocat, such as --git URL --rev COMMIT} isocat
  PATH=$PWD/.tools/bin:$PATH
fi
# What your program needs to be built stands here, in the place of what master.py needs.
if [ -z "${MASTER:-}" ]; then
  [ -d .venv ] || python3 -m venv .venv
  .venv/bin/pip install --quiet pysoem==1.1.13
fi
exec ./check.sh results
