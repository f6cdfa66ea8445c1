#!/usr/bin/env bash
# Foreign witnesses for the schemas. Python's jsonschema validates reports of good and bad runs against the committed schemas,
# and refuses a document that is no report. The same for segment files and profiles: all that are committed, and those that
# the tests of the keys accept and refuse, so that the schemas for editors and the parser agree. taplo, which editors run,
# reads the schemas by the line in a file and by the project's own rules. Needs python3 with venv and a package index.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "jsonschema==4.25.1" "taplo==0.9.3"
cargo build --release --quiet --bin isocat
isocat="${CARGO_TARGET_DIR:-target}/release/isocat"
"$isocat" run --for 100ms --json > "$folder/good.json"
"$isocat" run --for 2s --json --no-drift-compensation > "$folder/drift.json" || [ $? -eq 1 ]
printf 'cycle = "125us"\n[[subdevice]]\ndevice = "kollmorgen_akd2g"\n' > "$folder/short.toml"
"$isocat" run "$folder/short.toml" --json > "$folder/refused.json" || [ $? -eq 2 ]
"$isocat" plan --json --suggest > "$folder/plan.json"
"$isocat" plan --json --prove --for 100ms > "$folder/proof.json"
check() { "$folder/venv/bin/python" "$folder/check.py" "$@"; }
cat > "$folder/check.py" <<'PYTHON'
import json, sys
from jsonschema import Draft202012Validator
schema = json.load(open(sys.argv[1]))
Draft202012Validator.check_schema(schema)
validator = Draft202012Validator(schema)
for path in sys.argv[2:]:
    validator.validate(json.load(open(path)))
    print("ok:", path.rsplit("/", 1)[1], "follows the schema")
broken = json.load(open(sys.argv[2])) | {"surprise": 1}
assert not validator.is_valid(broken) and not validator.is_valid({}), "the schema takes anything"
PYTHON
check docs/run-report.schema.json "$folder"/{good,drift,refused}.json
check docs/plan.schema.json "$folder"/{plan,proof}.json
"$isocat" plan --cycles 1us,500us,1ms --json > "$folder/cycles.json" || [ $? = 1 ]
check docs/plan-cycles.schema.json "$folder"/cycles.json
for file in box rack; do "$isocat" devices "crates/isocat/tests/esi/$file.xml" --json > "$folder/$file.json"; done
check docs/devices.schema.json "$folder"/{box,rack}.json

mkdir "$folder/keys"
# Of all packages, as `cargo test` has compiled them: with `-p` their dependencies would be compiled again, with fewer features.
ISOCAT_KEYS="$folder/keys" cargo test --quiet --test files keys:: > "$folder/keys.log" || { cat "$folder/keys.log"; exit 1; }
cat > "$folder/toml.py" <<'PYTHON'
import json, pathlib, sys, tomllib
from jsonschema import Draft7Validator
corpus, least = pathlib.Path(sys.argv[1]), {"segment-file": 100, "profile": 180}
committed = {"segment-file": "crates/segment/segments", "profile": "crates/segment/profiles"}
for kind, folder in committed.items():
    schema = json.load(open(f"docs/{kind}.schema.json"))
    Draft7Validator.check_schema(schema)
    validator = Draft7Validator(schema)
    read = lambda path: tomllib.loads(path.read_text())
    files = sorted(pathlib.Path(folder).glob("*.toml"))
    good, bad = (sorted((corpus / kind / what).glob("*.toml")) for what in ("good", "bad"))
    assert files and len(good) > least[kind] and len(bad) > least[kind], (len(good), len(bad))
    for path in files + good:
        errors = [error.message for error in validator.iter_errors(read(path))]
        assert not errors, f"{path}: {errors}\n{path.read_text()}"
    for path in bad:
        assert not validator.is_valid(read(path)), f"{path} is taken\n{path.read_text()}"
    print(f"ok: {kind}: {len(files)} committed and {len(good)} good files follow the schema, {len(bad)} bad ones don't")
PYTHON
"$folder/venv/bin/python" "$folder/toml.py" "$folder/keys"

taplo() { RUST_LOG=error "$folder/venv/bin/taplo" "$@"; }
taplo check
cp docs/segment-file.schema.json "$folder/"
printf '#:schema ./segment-file.schema.json\ncycle = "1ms"\n[[subdevice]]\ndevice = "kollmorgen_akd2g"\n' > "$folder/mine.toml"
taplo check --config /dev/null "$folder/mine.toml"
sed 's/cycle/cylce/' "$folder/mine.toml" > "$folder/wrong.toml"
if taplo check --config /dev/null "$folder/wrong.toml" 2> "$folder/wrong.log"; then echo "taplo takes a wrong file"; exit 1; fi
grep -q "'cylce' was unexpected" "$folder/wrong.log"
echo "ok: taplo finds the schemas and marks an unknown key"
