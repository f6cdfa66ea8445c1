#!/usr/bin/env bash
# docs/examples/master-in-ci as a CI runs it: a copy of the folder, a user without privileges, no network, and a foreign reader of its
# JUnit. Once as it is, and once with an expectation that can't be held.
set -euo pipefail
cd "$(dirname "$0")/../.."
# Of all packages, as `cargo test` has compiled them: with `-p` their dependencies would be compiled again, with fewer features.
cargo build --quiet --locked --bins --examples
target=${CARGO_TARGET_DIR:-target}/debug
python=$(cd tests/interop && python3 -c 'from main_devices import install; peers = install(["pysoem"]); print(peers["pysoem"][0] if peers else "")')
[ -n "$python" ] || { echo "pysoem can't be had"; exit 77; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp -r docs/examples/master-in-ci "$folder/master"
rm -rf "$folder/master/results"
# Where a user without privileges may run it.
cp "$target/isocat" "$folder/isocat"
chmod 755 "$folder"
as_nobody=()
if [ "$(id -u)" -eq 0 ] && command -v setpriv >/dev/null && unshare --net true; then
  none=(unshare --net setpriv --no-new-privs --bounding-set -all)
  nobody=("${none[@]}" --reuid 65534 --regid 65534 --clear-groups)
  # Behind env: what setpriv itself starts still has its rights.
  if "${nobody[@]}" env "$python" -c 'import pysoem' 2>/dev/null; then
    chown -R 65534:65534 "$folder"
    as_nobody=("${nobody[@]}")
  else
    # The interpreter lies where no other user may read: the same user, without capabilities.
    as_nobody=("${none[@]}")
  fi
fi

job() { # EXIT-CODE FAILURES
  local code=0
  "${as_nobody[@]}" env HOME="$folder" ISOCAT="$folder/isocat" SEEDS=2 MASTER="$python master.py vt0" \
    "$folder/master/ci.sh" >"$folder/log" 2>&1 || code=$?
  if grep -q "can't be supervised here" "$folder/log"; then cat "$folder/log"; exit 77; fi
  [ "$code" -eq "$1" ] || { cat "$folder/log"; printf 'exit code %s, expected %s\n' "$code" "$1"; exit 1; }
  python3 - "$folder/master/results/junit.xml" "$2" <<'PYTHON'
import sys
import xml.etree.ElementTree as ElementTree

suite = ElementTree.parse(sys.argv[1]).getroot().find("testsuite")
failed = [test.get("name") for test in suite.iter("testcase") if test.find("failure") is not None]
assert len(list(suite.iter("testcase"))) == int(suite.get("tests")) == 3, suite.attrib
assert len(failed) == int(suite.get("failures")) == int(sys.argv[2]), failed
print(f"master-in-ci: {len(failed)} of {suite.get('tests')} tests failed, as expected", *failed, sep="\n  ")
PYTHON
}
cmp docs/recipes/pysoem_dc.py docs/examples/master-in-ci/master.py
job 0 0
sed -i 's/^worst_sync0 = "1us"/worst_sync0 = "10ns"/' "$folder/master/master.toml"
job 1 1
