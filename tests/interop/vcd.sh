#!/usr/bin/env bash
# A foreign witness for the waveforms: Python's vcdvcd reads them and finds the SYNC0 pulses a cycle apart. Needs python3 with
# venv and a package index.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "vcdvcd==2.6.0"
cargo build --release --quiet --bin isocat
"${CARGO_TARGET_DIR:-target}/release/isocat" run --for 100ms --waves "$folder/run.vcd" > "$folder/report.txt"
"$folder/venv/bin/python" - "$folder/run.vcd" <<'PYTHON'
import sys
from vcdvcd import VCDVCD
vcd = VCDVCD(sys.argv[1])
assert vcd.timescale["timescale"] == 1e-12 or str(vcd.timescale["timescale"]) == "1E-12", vcd.timescale
pulses = {name: [at for at, value in vcd[name].tv if value == "1"] for name in vcd.signals if name.endswith(".sync0")}
running = {name: times for name, times in pulses.items() if times}
assert len(running) == 3, running.keys()
for name, times in running.items():
    apart = [b - a for a, b in zip(times, times[1:])]
    assert len(times) >= 100 and max(abs(a - 10**9) for a in apart) < 10**5, (name, len(times), min(apart), max(apart))
    print(f"ok: {name}: {len(times)} pulses, {min(apart)} to {max(apart)} ps apart")
PYTHON
