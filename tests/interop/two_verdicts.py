#!/usr/bin/env python3
"""Two verdicts of one wire: `isocat run --interface` by registers and frames, `isocat serve` in true time beside it.

Each run has a served segment of three drives behind a veth pair in a namespace of its own, a MainDevice on it, and a fault by
`isocat control` at a random instant (or none). At the end it is compared who said what. What only the served side found is
silent on the wire: the exit code is 1 if there is such a run.

    tests/interop/two_verdicts.py [RUNS] [SEED]        ISOCAT=path/to/isocat; root. Exit 77: no root, or no `ip`.
"""

import collections
import json
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile
import time

SEGMENT = """cycle = "10ms"
hop_jitter = true
[[subdevice]]
device = "kollmorgen_akd2g"
clock = "+20ppm"
[[subdevice]]
device = "hpmicro_ecat_cia402_ssc"
clock = "-15ppm"
cable = "10m"
[[subdevice]]
device = "kollmorgen_akd2g"
clock = "+5ppm"
"""


def faults(chance):
    """One fault as commands of `control`, each with the time to wait behind it."""
    kind = chance.choice(["none", "drop", "drop", "delay", "loss", "pull", "power"])
    place = str(chance.randrange(3))
    if kind == "none":
        return kind, []
    if kind == "drop":
        return kind, [(["drop", str(chance.randint(1, 4))], 0)]
    if kind == "delay":
        return kind, [(["delay", f"{chance.randint(50, 9000)}us"], chance.uniform(0.02, 0.3)), (["delay", "0us"], 0)]
    if kind == "loss":
        return kind, [(["loss", f"{chance.randint(1, 30)}%"], chance.uniform(0.05, 0.5)), (["loss", "0%"], 0)]
    if kind == "pull":
        return kind, [(["pull", place], chance.uniform(0.005, 0.2)), (["plug", place], 0)]
    return kind, [(["power-cycle", place, f"{chance.randint(5, 200)}ms"], 0)]


def one(isocat, folder, number, chance):
    name = f"tv{os.getpid() % 10000}"
    segment, summary = folder / "segment.toml", folder / "summary.json"
    segment.write_text(SEGMENT)
    summary.unlink(missing_ok=True)
    serve = subprocess.Popen(
        [isocat, "serve", segment, "--setup-veth", name, "--report", summary, "--seed", str(number)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )

    def control(*words):
        return subprocess.run([isocat, "control", f"{name}-seg", *words], capture_output=True, text=True)

    try:
        until = time.monotonic() + 20
        while control("status").returncode != 0:
            if serve.poll() is not None or time.monotonic() > until:
                return None, f"serve did not begin: {serve.stderr.read().decode()[:200]}"
            time.sleep(0.1)
        run = subprocess.Popen(
            [isocat, "run", segment, "--interface", name, "--netns", name, "--for", "3s", "--json"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        kind, steps = faults(chance)
        # The way up takes about two seconds at this cycle; what comes earlier meets it, which is one of the cases.
        time.sleep(chance.uniform(2.5, 4.5))
        for words, pause in steps:
            control(*words)
            time.sleep(pause)
        out, words = run.communicate(timeout=120)
    finally:
        control("stop")
        try:
            serve.wait(20)
        except subprocess.TimeoutExpired:
            serve.kill()
    if not out.strip():
        return None, words.decode()[:200]
    report = json.loads(out)
    if report["judged_ns"] == 0:
        return None, report["verdict"]
    sessions = json.loads(summary.read_text())["sessions"]
    judged = [session["judged"] for session in sessions if session["judged"]]
    if not judged:
        return None, "nothing was judged on the served side"
    judged = judged[-1]
    stretches = [*judged["earlier"], *judged["devices"]]
    truth = sorted({found["kind"] for stretch in stretches for found in stretch["kinds"]})
    wire = sorted({found["kind"] for found in report["findings"]})
    skipped = report["punctuality"]["cycles_skipped"] + report["punctuality"]["frames_lost"]
    return (kind, judged["in_sync"], truth, report["answer"], wire, skipped), None


def main():
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    isocat = os.environ.get("ISOCAT") or "target/debug/isocat"
    if os.geteuid() != 0 or not shutil.which("ip"):
        print("skipped: needs root and ip")
        sys.exit(77)
    chance = random.Random(seed)
    table, silent, out = collections.Counter(), [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(runs):
            result, why = one(isocat, pathlib.Path(folder), seed * 1000 + number, chance)
            if result is None:
                out.append(why)
                table["not judged"] += 1
                print(f"{number}: not judged: {why}", flush=True)
                continue
            kind, in_sync, truth, answer, wire, skipped = result
            table[f"served {'in sync' if in_sync else 'lost'}, wire {answer}"] += 1
            print(f"{number}: {kind}: served {truth or 'in sync'}; wire {answer} {wire}", flush=True)
            if not in_sync and answer == "in-sync":
                silent.append(number)
    for what, count in sorted(table.items()):
        print(f"{what}: {count}")
    print(f"silent on the wire: {len(silent)} {silent}")
    sys.exit(1 if silent else 0)


main()
