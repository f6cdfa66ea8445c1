#!/usr/bin/env bash
# A foreign witness for the report: Python's jsonschema validates reports of good and bad runs against the committed schema,
# and refuses a document that is no report. Needs python3 with venv and a package index.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "jsonschema==4.25.1"
cargo build --release --quiet
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
