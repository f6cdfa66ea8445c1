#!/usr/bin/env python3
"""Programs with one mistake each, and right ones beside them: what `isocat virtual` and `isocat diagnose --segment` say of them.

Each program is mistakes_pysoem.py over a segment of tests/interop/mistakes/, with the name of its mistake; `virtual` judges the run, and
`diagnose` its capture. A wrong one must not end with exit code 0, a right one must, and where the mistake has a place the first line
names it. Neither root nor an interface is needed.

    mistakes.py [--isocat PATH] [--segment NAME] [--only MISTAKE]...

Exit codes: 0 all well, 1 a wrong program was green or a right one red, 77 could not be tried.
"""
import argparse
import collections
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from main_devices import TARGET, install

HERE = Path(__file__).parent
PROGRAM = HERE / "mistakes_pysoem.py"

# Kind of mistake: its programs. A position behind @ is the SubDevice whose part is wrong.
WRONG = {
    "SYNC0 never, late, at the wrong device, off": "sync0-never sync0-first-only sync0-wrong-device sync0-not-target sync-before-dc "
    "sync-after-safeop sync-after-op sync-off-in-op sync-again-in-op activate-no-cyclic activate-0x0700",
    "cycle of SYNC0": "cycle-half cycle-double cycle-double-one cycle-3ms cycle-1ns-more cycle-zero",
    "shift, start, phase of SYNC0": "shift-0 shift-in-us shift-60us shift-one-300us shift-one-5us start-past start-off-grid-one "
    "sync-shift-in-op",
    "clocks": "no-config-dc no-converge offset-zero delay-5us offset-in-op reference-in-op",
    "states": "op-never op-not-target",
    "drive": "interpolation-10ms interpolation-left interpolation-one",
    "SyncManager, FMMU, watchdog": "watchdog-off watchdog-1ms watchdog-off-in-op sm-size fmmu-overlap fmmu-short fmmu-outputs-off "
    "fmmu-inputs-off",
    "the loop": "no-phase-control phase-on-sync0 phase-gain-3 period-double period-half every-second-cycle frame-twice clock-step-host "
    "second-program",
}
RIGHT = "good interpolation config-dc-first config-dc-twice sync-twice type-and-cycle states-one-by-one filters-other half-gain read-state-each"
# These don't concern every segment.
ELSEWHERE = {
    "ssc": {
        "SYNC0 never, late, at the wrong device, off": "sync0-never sync0-first-only sync-after-safeop sync-off-in-op",
        "cycle of SYNC0": "cycle-half cycle-double cycle-double-one cycle-1ns-more",
        "shift, start, phase of SYNC0": "shift-0 shift-60us shift-one-300us shift-one-5us start-past",
        "mode": "type-free",
        "SyncManager, FMMU, watchdog": "fmmu-overlap fmmu-inputs-off watchdog-off-in-op",
        "the loop": "no-phase-control phase-on-sync0 second-program",
        "states": "op-never op-not-target",
    },
    "unassigned": {"SyncManager, FMMU, watchdog": "good sync0-never"},
    "coupler": {
        "SYNC0 never, late, at the wrong device, off": "sync0-never sync0-first-only sync-after-safeop activate-no-cyclic",
        "cycle of SYNC0": "cycle-double cycle-1ns-more",
        "shift, start, phase of SYNC0": "shift-one-300us shift-one-5us start-past start-off-grid-one",
        "clocks": "offset-zero delay-5us offset-in-op",
        "SyncManager, FMMU, watchdog": "fmmu-inputs-off fmmu-outputs-off fmmu-overlap watchdog-off-in-op",
        "the loop": "no-phase-control phase-on-sync0 period-half",
        "states": "op-never op-not-target",
    },
    "line": {
        "SYNC0 never, late, at the wrong device, off": "sync0-never sync0-not-target@3 sync0-not-target@7 sync-off-in-op@5",
        "cycle of SYNC0": "cycle-double-one@2 cycle-double-one@7",
        "shift, start, phase of SYNC0": "shift-one-300us@4 shift-one-5us@7 start-off-grid-one@6 sync-shift-in-op@4",
        "clocks": "offset-in-op@7 delay-5us@6",
        "SyncManager, FMMU, watchdog": "watchdog-off-in-op@3 fmmu-inputs-off@6 fmmu-overlap@5",
        "states": "op-not-target@5 op-not-target@7",
        "the loop": "no-phase-control frame-twice",
    },
}
RIGHT_ELSEWHERE = {"ssc": RIGHT, "unassigned": "", "coupler": "good config-dc-twice half-gain", "line": "good sync-twice"}
# The program gives up itself, by an exception of the library.
GIVES_UP = {"sm-size"}


class Case:
    def __init__(self, segment, kind, mistake):
        self.segment, self.kind, self.mistake = segment, kind, mistake
        self.right = kind == "right"

    def run(self, isocat, python):
        segment = HERE / "mistakes" / f"{self.segment}.toml"
        with tempfile.TemporaryDirectory(prefix="isocat-mistakes-") as folder:
            capture = Path(folder) / "run.pcapng"
            done = subprocess.run([isocat, "virtual", segment, "--json", "--capture", capture, "--", python, PROGRAM, self.mistake],
                                  capture_output=True, text=True)
            seen = subprocess.run([isocat, "diagnose", capture, "--segment", segment], capture_output=True, text=True)
        self.code = done.returncode
        self.first = next((line.strip() for line in done.stderr.splitlines() if line.startswith((" In sync", " Not "))), "")
        self.diagnosed = seen.returncode
        lines = (seen.stdout or seen.stderr).splitlines() + ["", ""]
        self.sentence = " ".join(lines[:2])
        try:
            self.summary = json.loads(done.stdout.splitlines()[-1])
        except (IndexError, ValueError):
            self.summary = {}
        return self

    def wrong(self):
        return self.wrongly_run() or self.wrongly_diagnosed()

    def wrongly_diagnosed(self):
        if self.diagnosed == 2:
            return f"no diagnosis: {self.sentence}"
        if self.right:
            return "" if self.diagnosed == 0 else f"diagnose RED {self.diagnosed}: {self.sentence}"
        return "diagnose GREEN" if self.diagnosed == 0 else ""

    def wrongly_run(self):
        if self.code == 2 or not self.summary:
            return "could not be tried"
        if self.right:
            return "" if self.code == 0 else f"RED {self.code}: {self.first}"
        if self.code == 4 and self.mistake.partition("@")[0] not in GIVES_UP:
            return f"the program failed: {self.first}"
        if self.code == 0:
            return "GREEN"
        place = self.mistake.partition("@")[2]
        return f"elsewhere: {self.first}" if place and f"SubDevice {place} " not in self.first else ""


def cases():
    for kind, mistakes in [*WRONG.items(), ("right", RIGHT)]:
        yield from (Case("axes", kind, mistake) for mistake in mistakes.split())
    for segment, kinds in ELSEWHERE.items():
        for kind, mistakes in [*kinds.items(), ("right", RIGHT_ELSEWHERE[segment])]:
            yield from (Case(segment, kind, mistake) for mistake in mistakes.split())


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--segment")
    parser.add_argument("--only", action="append", default=[])
    arguments = parser.parse_args()
    peers = install(["pysoem"])
    if not peers:
        return 77
    python = peers["pysoem"][0]
    chosen = [case for case in cases()
              if arguments.segment in (None, case.segment) and (not arguments.only or case.mistake in arguments.only)]
    table, failed = collections.defaultdict(lambda: [0, 0]), []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for case in pool.map(lambda case: case.run(arguments.isocat, python), chosen):
            wrong = case.wrong()
            table[case.kind][0] += 1
            table[case.kind][1] += bool(wrong)
            if wrong:
                failed.append(f"{case.segment}: {case.mistake}: {wrong}")
    print("| kind | programs | judged wrongly |\n|---|---|---|")
    for kind, (count, wrong) in table.items():
        print(f"| {kind} | {count} | {wrong} |")
    for line in failed:
        print(line)
    print(f"{len(chosen)} programs, {len(failed)} judged wrongly")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
