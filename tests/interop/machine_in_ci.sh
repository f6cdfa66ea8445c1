#!/usr/bin/env bash
# docs/examples/machine-in-ci as a CI runs it: a copy of the folder, a user without privileges, and a foreign reader of its JUnit.
# Once as it is, and once with a cycle that can't hold what is expected.
set -euo pipefail
cd "$(dirname "$0")/../.."
# Of all packages, as `cargo test` has compiled them: with `-p` their dependencies would be compiled again, with fewer features.
cargo build --quiet --locked --bins --examples
target=${CARGO_TARGET_DIR:-target}/debug
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp -r docs/examples/machine-in-ci "$folder/machine"
rm -rf "$folder/machine/results"
# Where a user without privileges may run it.
cp "$target/isocat" "$folder/isocat"
as_nobody=()
if [ "$(id -u)" -eq 0 ] && command -v setpriv >/dev/null; then
  chown -R 65534:65534 "$folder"
  as_nobody=(setpriv --reuid 65534 --regid 65534 --clear-groups --no-new-privs --bounding-set -all)
fi

job() { # EXIT-CODE FAILURES
  local code=0
  "${as_nobody[@]}" env HOME="$folder" ISOCAT="$folder/isocat" SEEDS=3 "$folder/machine/ci.sh" >"$folder/log" 2>&1 || code=$?
  [ "$code" -eq "$1" ] || { cat "$folder/log"; printf 'exit code %s, expected %s\n' "$code" "$1"; exit 1; }
  python3 - "$folder/machine/results/junit.xml" "$2" <<'PYTHON'
import sys
import xml.etree.ElementTree as ElementTree

suite = ElementTree.parse(sys.argv[1]).getroot().find("testsuite")
failed = [test.get("name") for test in suite.iter("testcase") if test.find("failure") is not None]
assert len(list(suite.iter("testcase"))) == int(suite.get("tests")) == 5, suite.attrib
assert len(failed) == int(suite.get("failures")) == int(sys.argv[2]), failed
print(f"machine-in-ci: {len(failed)} of {suite.get('tests')} tests failed, as expected", *failed, sep="\n  ")
PYTHON
}
python3 - "$folder/machine/.github/workflows/machine.yml" <<'PYTHON'
import sys

try:
    import yaml
except ImportError:
    print("machine.yml: not read, PyYAML is missing")
    sys.exit()
steps = yaml.safe_load(open(sys.argv[1]))["jobs"]["check"]["steps"]
assert [step["run"] for step in steps if "run" in step] == ["PATH=$PWD/.tools/bin:$PATH ./ci.sh"], steps
kept = steps[-1]
assert kept["if"] == "always()" and kept["with"]["path"] == "results", kept
PYTHON
job 0 0
sed -i 's/^cycle = "1ms"/cycle = "4ms"/' "$folder/machine/machine.toml"
job 1 1
