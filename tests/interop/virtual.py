#!/usr/bin/env python3
"""Foreign MainDevices, unmodified, in virtual time: pysoem (SOEM), kickcat (KickCAT) and ethercrab under `isocat virtual`.

Each of them goes through all steps of main_devices.py at each of its segments, twice: no step may fail, and both runs have to be the
same to the byte, in what the MainDevice prints and in what went over the wire. Neither root nor an interface is needed, and a
machine that is busy makes no difference.

    virtual.py [--isocat PATH] [--only PEER] [--segment NAME] [--cycles N]

Exit codes: 0 all well, 1 something failed, 77 could not be tried.
"""
import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from main_devices import SEGMENTS, TARGET, Segment, install

INTERFACE = "vt0"
# The verdict is not asked for here: a MainDevice that sets up no SYNC is "not known", and one that programs it badly is told so.
ENDED_WELL = (0, 1, 3)
CAN_NOT = "can't be supervised here"


class Run:
    """One run: what the MainDevice said, and what isocat says of it."""

    def __init__(self, isocat, command, segment):
        file = [segment.file] if segment.file else []
        begun = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([isocat, "virtual", *file, "--interface", INTERFACE, "--json", "--",
                               *command, INTERFACE, segment.task, "whole"], capture_output=True, text=True)
        ended = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.seconds = ended.ru_utime + ended.ru_stime - begun.ru_utime - begun.ru_stime
        self.code, self.errors = done.returncode, done.stderr
        lines = done.stdout.splitlines()
        self.said = lines[:-1]
        self.summary = json.loads(lines[-1]) if lines else {}
        self.program = self.summary.get("program", {})

    def wrong(self):
        if self.code not in ENDED_WELL:
            return f"exit code {self.code}: {self.errors.strip().splitlines()[-3:]} {self.said[-1:]}"
        if (self.program.get("how"), self.program.get("code")) != ("exited", 0):
            return f"the MainDevice {self.program.get('how')} {self.program.get('code')}: {self.said[-1:]}"
        # Some libraries print words of their own between.
        steps = [json.loads(line) for line in self.said if line.startswith('{"step"')]
        failed = [step for step in steps if step["result"] == "failed"]
        return f"failed: {failed}" if failed else ""

    def same(self):
        """What two runs have in common, if they are the same."""
        return self.said, self.code, {key: self.program[key] for key in ("wire_hash", "lasted_ns", "stops", "frames_sent")}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--only", choices=["pysoem", "kickcat", "ethercrab"])
    parser.add_argument("--segment", choices=list(SEGMENTS))
    parser.add_argument("--cycles", type=int, default=10_000)
    arguments = parser.parse_args()
    peers = install([arguments.only] if arguments.only else ["pysoem", "kickcat", "ethercrab"])
    if not peers:
        return 77
    folder, wrong = Path(tempfile.mkdtemp(prefix="isocat-virtual-")), 0
    try:
        for name in [arguments.segment] if arguments.segment else SEGMENTS:
            segment = Segment(arguments.isocat, folder, name, arguments.cycles)
            for peer, command in peers.items():
                runs = [Run(arguments.isocat, command, segment) for _ in range(2)]
                if any(CAN_NOT in run.errors for run in runs):
                    print(f"skipped: {runs[0].errors.strip()}")
                    return 77
                bad = next(filter(None, (run.wrong() for run in runs)), "")
                if not bad and runs[0].same() != runs[1].same():
                    bad = f"two runs differ: {runs[0].same()[2]}, {runs[1].same()[2]}"
                wrong += bool(bad)
                program, seconds = runs[0].program, min(run.seconds for run in runs)
                lasted = program.get("lasted_ns", 0) / 1e9
                print(f"{'FAILED' if bad else 'ok'}: {peer} at {name}: {lasted:.3f} s virtual, {seconds:.2f} s of processors, "
                      f"{program.get('frames_sent')} frames, {program.get('stops')} stops, {program.get('threads')} threads, "
                      f"wire {program.get('wire_hash')} {bad}", flush=True)
    finally:
        shutil.rmtree(folder)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
