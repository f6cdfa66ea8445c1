#!/usr/bin/env python3
"""What foreign MainDevices notice: each of them with many seeds of faults in virtual time, judged in true time.

Every run draws 1 to 4 faults (`isocat virtual --seeds --faults swarm`) over two drives and an I/O. The MainDevices are those of
main_devices.py: they look at the working counter of each cycle, and at states every ten cycles while something is not right. A run
counts for a fault if it is one of its faults; lost is what the judges saw in true time; noticed is a working counter, a lost frame or
a state that the library told, or a way up that failed. That a MainDevice notices nothing may be the wire's doing: nothing on it shows
that outputs came late to a drive whose counters nobody reads.

    virtual_campaign.py [--isocat PATH] [--seeds N] [--first-seed N] [--only PEER] [--soem COMMAND] [--json FILE]

--soem: a build of docs/recipes/soem.c, which can't be had from a package index. It prints no working counters: only its last states
tell. The result is a table for docs/virtual.md. Exit codes: 0 tried, 1 a run ended in a way that is not known, 77 could not be tried.
"""
import argparse
import collections
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from main_devices import TARGET, Segment, install, SEGMENTS

INTERFACE = "vt0"
SEGMENT = """cycle = "4ms"
for = "4s"
[host]
jitter = "50us"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 1"
[[subdevice]]
device = "kollmorgen_akd2g"
name = "axis 2"
[[subdevice]]
device = "simple_io16"
name = "io"
"""
CYCLES = 1000
# As many as bring the clocks together: a MainDevice that sends fewer is out of sync without any
# fault.
DRIFT_FRAMES = 3000


class Run:
    """One seed."""

    def __init__(self, isocat, folder, segment, seed, command):
        here = folder / f"seed-{seed}"
        done = subprocess.run([isocat, "virtual", segment, "--seeds", "1", "--seed", str(seed), "--faults", "swarm", "--jobs", "1",
                               "--for", "120s", "--failed", here, "--", *command], capture_output=True, text=True)
        if done.returncode not in (0, 1):
            raise RuntimeError(f"seed {seed}: {done.stderr.strip()}")
        self.seed = seed
        self.faults = {fault["what"].split()[0] for fault in tomllib.loads((here / "run-0.toml").read_text()).get("fault", [])}
        report = json.loads((here / "run-0.json").read_text())
        said = (here / "run-0.txt").read_text(errors="replace").splitlines()
        shutil.rmtree(here)
        self.program = report["program"]
        sessions = report["sessions"]
        self.lost = not sessions or sessions[-1]["answer"] != "in-sync" or any(s["judged"]["earlier"] for s in sessions if s["judged"])
        steps = [json.loads(line) for line in said if line.startswith('{"step"')]
        told = next((step["noticed"] for step in steps if "noticed" in step), {})
        self.failed = next((step["step"] for step in steps if step["result"] == "failed"), "")
        self.noticed = bool(self.failed or any(told.values()) or self.program["how"] != "exited" or self.program["code"])
        if not steps:
            # The recipe: what it prints of states, and SubDevices that fell.
            self.noticed |= any(": state " in line and ": state 8," not in line or " fell" in line for line in said)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--only", choices=["pysoem", "kickcat", "ethercrab", "soem"])
    parser.add_argument("--soem", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    names = [name for name in ["pysoem", "kickcat", "ethercrab"] if arguments.only in (None, name)]
    folder = Path(tempfile.mkdtemp(prefix="isocat-campaign-"))
    try:
        segment = folder / "segment.toml"
        segment.write_text(SEGMENT)
        SEGMENTS["campaign"] = (SEGMENT, 4000, [0, 1], {})
        task = Segment(arguments.isocat, folder, "campaign", CYCLES, DRIFT_FRAMES).task
        commands = {name: [*command, INTERFACE, str(task), "whole"] for name, command in install(names).items()}
        if arguments.soem and arguments.only in (None, "soem"):
            # As long in OP as the others.
            commands["soem"] = [arguments.soem.resolve(), INTERFACE, "1500"]
        if not commands:
            return 77
        table = {name: tried(arguments, folder, segment, command) for name, command in commands.items()}
    finally:
        shutil.rmtree(folder)
    show(table)
    if arguments.json:
        arguments.json.write_text(json.dumps({name: [vars(run) | {"faults": sorted(run.faults)} for run in runs]
                                              for name, runs in table.items()}))
    return 0


def tried(arguments, folder, segment, command):
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return list(threads.map(lambda seed: Run(arguments.isocat, folder, segment, seed, command), seeds))


def show(table):
    for name, runs in table.items():
        ends = collections.Counter(f"{run.program['how']} {run.program['code'] or ''}".strip() for run in runs)
        lost = [run for run in runs if run.lost]
        unnoticed = [run.seed for run in lost if not run.noticed]
        alarms = [run.seed for run in runs if run.noticed and not run.lost]
        print(f"{name}: {len(runs)} runs, {len(lost)} lost something, {len(unnoticed)} of them unnoticed (first seeds {unnoticed[:3]}); "
              f"{len(alarms)} noticed something without a loss; ended: {dict(ends)}")
    names = list(table)
    print("\n| fault | " + " | ".join(names) + " |")
    print("|---|" + "---|" * len(names))
    for fault in sorted({fault for runs in table.values() for run in runs for fault in run.faults}):
        cells = []
        for runs in table.values():
            lost = [run for run in runs if fault in run.faults and run.lost]
            silent = [run.seed for run in lost if not run.noticed]
            cells.append(f"{len(lost) - len(silent)} of {len(lost)}" + (f" ({silent[0]})" if silent else ""))
        print(f"| {fault} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    sys.exit(main())
