#!/usr/bin/env bash
# A foreign witness for series: pyarrow reads a run's table as CSV and as Parquet. Both are equal, their types are as documented,
# and the figures are those of the report of the same run. The same for the rows of a sweep. Needs python3 with venv and a package index.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "pyarrow==26.0.1"
if [ -z "${ISOCAT:-}" ]; then
  cargo build --release --quiet --bin isocat
  ISOCAT="${CARGO_TARGET_DIR:-target}/release/isocat"
fi
# More rows than a row group has: 5 SubDevices, 20 s in cycles of 1 ms.
for ending in csv parquet; do
  "$ISOCAT" run --for 20s --seed 7 --series "$folder/run.$ending" --json > "$folder/$ending.json"
done
cmp "$folder/csv.json" "$folder/parquet.json"
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json, re, sys
import pyarrow as pa, pyarrow.compute as pc, pyarrow.csv, pyarrow.parquet
folder = sys.argv[1]
file = pyarrow.parquet.ParquetFile(f"{folder}/run.parquet")
table = file.read()
read = pyarrow.csv.read_csv(f"{folder}/run.csv", convert_options=pyarrow.csv.ConvertOptions(
    column_types=table.schema, strings_can_be_null=False))
assert table.column_names == read.column_names, (table.column_names, read.column_names)
for name in table.column_names:
    assert table[name].combine_chunks().equals(read[name].combine_chunks()), name
assert file.num_row_groups == 2, file.num_row_groups
print(f"ok: {table.num_rows} rows in CSV and Parquet ({file.num_row_groups} row groups), equal")

documented = {}
for line in open("docs/exports.md"):
    row = re.match(r"\| `(\w+)` \| (int64|string)( or null)? \|", line)
    if row:
        documented[row[1]] = (row[2], row[3] is not None)
found = {field.name: (str(field.type), field.nullable) for field in table.schema}
assert documented == found, (documented, found)
print(f"ok: {len(found)} columns with the types that docs/exports.md tells")

report = json.load(open(f"{folder}/csv.json"))
for device in report["devices"]:
    rows = table.filter(pc.equal(table["position"], device["position"]))
    cycles = rows["cycle"].to_pylist()
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles))) and len(cycles) >= 20_000, len(cycles)
    assert set(rows["name"].to_pylist()) == {device["name"]}
    for column, unit, told in [("sync0_error_ps", 1000, "sync0_error"), ("margin_ns", 1, "sync0_margin")]:
        values, figures = rows[column].drop_null(), device["true_time"][told]
        if figures is None:
            assert len(values) == 0, (device["name"], column)
            continue
        assert len(values) == figures["count"], (device["name"], column, len(values), figures)
        mean, deviation = pc.mean(values).as_py() / unit, pc.stddev(values).as_py() / unit
        extremes = pc.min_max(values).as_py()
        # The report rounds to the ps.
        assert abs(mean - figures["mean_ns"]) <= 0.0005001, (device["name"], column, mean, figures)
        assert abs(deviation - figures["standard_deviation_ns"]) <= 0.0005001, (device["name"], column, deviation, figures)
        assert (extremes["min"] / unit, extremes["max"] / unit) == (figures["min_ns"], figures["max_ns"])
        print(f"ok: {device['name']}: {column}: {len(values)} values, mean {mean:.3f} ns, report {figures['mean_ns']} ns")
    differences = rows["system_time_difference_ns"].drop_null()
    assert len(differences) == len(rows) and pc.max(pc.abs(differences)).as_py() < 200, device["name"]
    assert pc.max(rows["sm_event_missed"]).as_py() in (0, None), device["name"]
main = report["segment"]["main_device"]
phase = table.filter(pc.equal(table["position"], 0))["host_phase_error_ns"].drop_null()
assert abs(pc.mean(phase).as_py() - main["host_phase_error"]["mean_ns"]) < 20, (pc.mean(phase), main)
assert pc.max(table["frames_lost"]).as_py() == main["frames_lost"] == 0
PYTHON

# Rows of a sweep: more than a row group has, cells that are empty, an axis of numbers and one of texts.
cat > "$folder/sweep.toml" <<'TOML'
cycle = "1ms"
for = "10ms"
[[subdevice]]
device = "simple_io16"
TOML
for ending in csv parquet; do
  "$ISOCAT" sweep "$folder/sweep.toml" --vary host.difference_filter=2,4 --vary host.jitter=5us,499us --vary sync0_limit=100ns..1us \
    --faults swarm --seeds 3000 --rows "$folder/sweep.$ending" > "$folder/sweep.txt" || [ $? = 1 ]
done
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
import pyarrow.csv, pyarrow.parquet
folder = sys.argv[1]
file = pyarrow.parquet.ParquetFile(f"{folder}/sweep.parquet")
table = file.read()
read = pyarrow.csv.read_csv(f"{folder}/sweep.csv", convert_options=pyarrow.csv.ConvertOptions(
    column_types=table.schema, strings_can_be_null=True, null_values=[""]))
assert table.column_names == read.column_names, (table.column_names, read.column_names)
for name in table.column_names:
    assert table[name].combine_chunks().equals(read[name].combine_chunks()), name
assert file.num_row_groups == 2 and table.num_rows == 12_000, (file.num_row_groups, table.num_rows)
types = {field.name: str(field.type) for field in table.schema}
assert types["number"] == types["worst_sync0_ps"] == types["host.difference_filter"] == "int64" and types["as_expected"] == "bool", types
assert types["host.jitter"] == types["verdict"] == "string", types
assert table["number"].to_pylist() == list(range(12_000))
assert 0 < table["finding"].null_count < 12_000 and table["verdict"].null_count == 0
print(f"ok: {table.num_rows} rows of a sweep in CSV and Parquet ({file.num_row_groups} row groups), equal")
PYTHON
