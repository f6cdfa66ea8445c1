#!/usr/bin/env python3
"""How often `isocat diagnose` is right about foreign MainDevices: pysoem, KickCAT and ethercrab in virtual time, each under each kind of
fault, captured at the MainDevice's port. The second table of docs/diagnose.md.

Right is the kind of the first fault and, where a device is at fault, that device; unknown is no fault or no device. A run without a
fault has to be without one. Wanted: right in 95 of 100 where the frames show it at all, wrong in fewer than one.

    diagnose_masters.py [--isocat PATH] [--seeds N] [--only PEER] [--soem COMMAND]

--soem: docs/recipes/soem.c, built. Exit codes: 0 as wanted, 1 not, 77 could not be tried.
"""
import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from main_devices import SEGMENTS, TARGET, Segment, install

INTERFACE = "vt0"
CAN_NOT = "can't be supervised here"
SEGMENT = """cycle = "4ms"
[host]
jitter = "20us"
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
CYCLES, DRIFT_FRAMES = 750, 3000
# What goes wrong, the kinds of which the first fault has to be one, and whether that names the device. AXIS is each axis in turn. A cable
# in front of the first device takes all frames: nothing in the capture then names a device.
FAULTS = [
    ("", None, False),
    ("pull AXIS for 200ms", ["devices-vanished", "device-silent"], True),
    ("power-off AXIS for 200ms", ["devices-vanished", "device-silent"], True),
    ("power-cycle AXIS 100ms", ["devices-vanished", "device-silent"], True),
    ("replace AXIS simple_io16 100ms", ["devices-vanished", "device-silent"], True),
    ("break AXIS back for 200ms", ["devices-vanished", "device-silent"], True),
    ("al-error AXIS 0x8001", ["left-op", "al-error"], True),
    ("sync-off AXIS for 100ms", ["left-op", "al-error"], True),
    ("stall 50ms", ["cycles-skipped", "gap-seen"], False),
    ("drop 2", ["frames-lost"], False),
    ("loss 5% for 400ms", ["frames-lost"], False),
    ("damage 3 out at AXIS", ["frames-lost"], False),
    ("double 5 out", ["frames-doubled"], False),
]
# KickCAT's binding sets up no SYNC.
NO_EFFECT = {("kickcat", "sync-off")}
# It reads no states either, and its frames carry no time: a device that left OP is one of several, and a frame that was taken twice looks as
# if the file had it twice.
NOT_SHOWN = {("kickcat", "al-error"), ("kickcat", "double")}


class Try:
    def __init__(self, arguments, folder, command, fault, axis, seed):
        what, self.kinds, names = fault
        self.what, self.axis = what or "healthy", axis
        if axis == 1 and what.split(" ")[0] in ("pull", "break"):
            # Who waits long for each answer loses few frames in that time.
            self.kinds, names = ["nothing-came-back", "frames-lost"], False
        if names:
            # Where nothing but process data is exchanged, working counters are all that a capture has.
            self.kinds = [*self.kinds, "working-counter"]
        name = f"{abs(hash((what, axis, seed, str(command))))}"
        segment, capture = folder / f"{name}.toml", folder / f"{name}.pcapng"
        table = f'[[fault]]\nat = "in-operation + 700ms"\nwhat = "{what.replace("AXIS", f"axis {axis}")}"\n' if what else ""
        segment.write_text(SEGMENT + table)
        run = subprocess.run([arguments.isocat, "virtual", segment, "--seed", str(seed), "--capture", capture, "--for", "60s", "--", *command],
                             capture_output=True, text=True)
        self.can_not = CAN_NOT in run.stderr
        if self.can_not:
            return
        done = subprocess.run([arguments.isocat, "diagnose", capture, "--json"], capture_output=True, text=True)
        if done.returncode == 2:
            raise RuntimeError(f"{what}: {done.stderr.strip()} {run.stderr[-300:]}")
        report = json.loads(done.stdout)
        capture.unlink()
        told = [one for one in report["findings"] if one["weight"] == "fault" or one["kind"] == "gap-seen" and "gap-seen" in (self.kinds or [])]
        first = told[0] if told else None
        self.found = first["kind"] if first else None
        device = first.get("device") if first else None
        place = report["devices"][device]["position"] if device is not None else None
        place = place["value"] if isinstance(place, dict) else place
        if first is None:
            self.hit = "right" if self.kinds is None else "unknown"
        elif self.kinds is None or self.found not in self.kinds:
            self.hit = "wrong"
        elif names and place is None:
            self.hit = "unknown"
        else:
            self.hit = "right" if not names or place == axis - 1 else "wrong"
        self.told = f"{self.what.replace('AXIS', f'axis {axis}')}, seed {seed}: {self.found} at {place}: {first['what'] if first else ''}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--only", choices=["pysoem", "kickcat", "ethercrab", "soem"])
    parser.add_argument("--soem", type=Path)
    arguments = parser.parse_args()
    names = [name for name in ["pysoem", "kickcat", "ethercrab"] if arguments.only in (None, name)]
    folder = Path(tempfile.mkdtemp(prefix="isocat-diagnose-"))
    hits = {}
    try:
        SEGMENTS["diagnosed"] = (SEGMENT, 4000, [0, 1], {})
        task = Segment(arguments.isocat, folder, "diagnosed", CYCLES, DRIFT_FRAMES).task
        commands = {name: [*command, INTERFACE, str(task), "whole"] for name, command in install(names).items()}
        if arguments.soem and arguments.only in (None, "soem"):
            commands["soem"] = [arguments.soem.resolve(), INTERFACE, "1200"]
        if not commands:
            return 77
        for name, command in commands.items():
            faults = [fault for fault in FAULTS if (name, fault[0].split(" ")[0]) not in NO_EFFECT]
            cases = [(fault, axis, seed) for fault in faults for axis in ((1, 2) if "AXIS" in fault[0] else (1,))
                     for seed in range(1, arguments.seeds + 1)]
            with ThreadPoolExecutor(os.cpu_count()) as threads:
                tries = list(threads.map(lambda case: Try(arguments, folder, command, *case), cases))
            if any(one.can_not for one in tries):
                print("skipped: programs can't be supervised here")
                return 77
            hits[name] = tries
    finally:
        shutil.rmtree(folder)
    return show(hits)


def show(hits):
    print("| fault | first | " + " | ".join(hits) + " |\n|---|---|" + "---|" * len(hits))
    for what, kinds, _ in FAULTS:
        cells = []
        for tries in hits.values():
            of = [one.hit for one in tries if one.what == (what or "healthy")]
            cells.append(" / ".join(str(of.count(hit)) for hit in ("right", "unknown", "wrong")) if of else "has no effect")
        print(f"| {what or 'healthy'} | {' or '.join(f'`{kind}`' for kind in kinds) if kinds else 'none'} | " + " | ".join(cells) + " |")
    every = [one for tries in hits.values() for one in tries]
    for name, tries in hits.items():
        for one in tries:
            if one.hit != "right":
                print(f"{name}: {one.hit}: {one.told}")
    right, wrong = (sum(one.hit == hit for one in every) for hit in ("right", "wrong"))
    shown = [one for name, tries in hits.items() for one in tries if (name, one.what.split(" ")[0]) not in NOT_SHOWN]
    right_of_shown = sum(one.hit == "right" for one in shown)
    print(f"{right} of {len(every)} right, {wrong} wrong; where frames show it {right_of_shown} of {len(shown)} right")
    healthy = [one for one in every if one.kinds is None]
    return int(right_of_shown < 0.95 * len(shown) or wrong >= 0.01 * len(every) or any(one.hit != "right" for one in healthy))


if __name__ == "__main__":
    sys.exit(main())
