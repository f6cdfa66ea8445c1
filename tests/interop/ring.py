#!/usr/bin/env python3
"""A foreign MainDevice with cable redundancy, unmodified, at a served ring: pysoem (SOEM) in its redundant mode on the two
interfaces that `isocat serve --setup-veth` makes for a ring, in a network namespace of their own.

Four devices come to OP. Then each cable in turn, the one that closes the ring too, is pulled by `isocat control` and plugged in
again, under process data: some cycles behind each change everything has to arrive as before, and no device may leave OP. At last
two cables are pulled at once, which must show: devices between two cuts are reached by nobody. The served segment must have
seen one MainDevice that did everything once.

    ring.py [--isocat PATH]

Real time on a shared machine: witness.py sees when the machine stalls, and a part of the run that it stalled in is tried again.

Needs root, `ip` and a package index for what it installs into the target directory. Exit codes: 0 all well, 1 something failed,
75 nothing failed but the machine was too late for some of it in each attempt, 77 could not be tried.
"""
import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from main_devices import HERE, PACKAGES, PROMPT, TARGET, TOOLS, install
from witness import Witness

DEVICES = 4
CYCLE_US = 2000
SEGMENT = f'cycle = "2ms"\nring = true\n[[subdevice]]\ndevice = "simple_io16"\nname = "io"\ncount = {DEVICES}\n'
CABLES = [*(f"io {position}" for position in range(DEVICES)), "ring"]
# From a change of a cable until everything has to arrive again. A link takes 300 ms to come back.
SETTLED = 0.5
WATCHED = 1.0
ATTEMPTS = 3


class Ring:
    """The served ring and the MainDevice on it."""

    def __init__(self, isocat, folder, python):
        self.isocat, self.folder = isocat, folder
        self.namespace = f"isorg{os.getpid() % 100_000}"
        self.cycles, self.operation = [], None
        segment = folder / "ring.toml"
        segment.write_text(SEGMENT)
        self.report = folder / "summary.json"
        serve = [isocat, "serve", segment, "--setup-veth", self.namespace, "--report", self.report, "--json"]
        self.server = subprocess.Popen(PROMPT + serve, stdout=subprocess.PIPE, text=True)
        greeting = json.loads(self.server.stdout.readline())
        assert greeting["event"] == "serving", greeting
        self.events, self.copier = [], threading.Thread(target=self.read_events)
        self.copier.start()
        ends = [greeting["main_end"], greeting["second_main_end"]]
        peer = ["ip", "netns", "exec", self.namespace, *PROMPT, python, HERE / "peer_ring.py", *ends, str(DEVICES), str(CYCLE_US)]
        self.peer = subprocess.Popen(peer, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.reader = threading.Thread(target=self.read_cycles)
        self.reader.start()

    def read_events(self):
        self.events += [json.loads(line) for line in self.server.stdout if line.startswith('{"')]

    def read_cycles(self):
        for line in self.peer.stdout:
            said = json.loads(line)
            self.operation = said.get("op", self.operation)
            if "at" in said:
                self.cycles.append(said)

    def wait_for_operation(self):
        deadline = time.monotonic() + 60
        while self.operation is None and self.peer.poll() is None and time.monotonic() < deadline:
            time.sleep(0.05)
        return self.operation is not None

    def control(self, *words):
        done = subprocess.run([self.isocat, "control", f"{self.namespace}-seg", *words], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    def between(self, begin, end):
        """The cycles of this time, and how many of them were not whole."""
        cycles = [cycle for cycle in list(self.cycles) if begin <= cycle["at"] < end]
        return cycles, [cycle for cycle in cycles if cycle["wkc"] != self.operation or not cycle["echo"]]

    def end(self):
        if self.peer.poll() is None:
            self.peer.stdin.close()
            try:
                self.peer.wait(20)
            except subprocess.TimeoutExpired:
                self.peer.kill()
        self.reader.join(20)
        self.server.send_signal(signal.SIGTERM)
        self.server.wait(20)
        self.copier.join(20)
        return json.loads(self.report.read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    arguments = parser.parse_args()
    for what, missing in [("root", os.geteuid() != 0), ("ip", not shutil.which("ip"))]:
        if missing:
            print(f"skipped: {what} is missing")
            return 77
    if not install(["pysoem"]):
        return 77
    python = TOOLS / "venv" / "bin" / "python"
    with tempfile.TemporaryDirectory(prefix="isocat-ring-") as folder, Witness(Path(folder)) as witness:
        return run(arguments.isocat, Path(folder), python, witness)


def run(isocat, folder, python, witness):
    ring = Ring(isocat, folder, python)
    results = []
    try:
        if not ring.wait_for_operation():
            print(f"failed: {PACKAGES['pysoem']} does not come to OP in the ring")
            return 1
        print(f"all {DEVICES} devices in OP, working counter {ring.operation}")
        results.append(phase(ring, witness, "whole ring", []))
        for cable in CABLES:
            results.append(phase(ring, witness, f"{cable} pulled", ["pull", cable]))
            results.append(phase(ring, witness, f"{cable} plugged in", ["plug", cable]))
        ring.control("pull", CABLES[1])
        results.append(between_two_cuts(ring))
    finally:
        summary = ring.end()
    results.append(conduct(ring, summary))
    return max(results, key=[0, 75, 1].index)


def phase(ring, witness, name, words):
    """One change, and what arrives afterwards."""
    for _ in range(ATTEMPTS):
        changed = time.monotonic()
        if words:
            ring.control(*words)
        time.sleep(SETTLED + WATCHED)
        begin, end = changed + SETTLED, changed + SETTLED + WATCHED
        _, lost = ring.between(changed, begin)
        cycles, wrong = ring.between(begin, end)
        stalls = [length for at, length in witness.stalls() if begin <= at < end]
        print(f"{name:<20} {len(lost):>3} cycles not whole at the change; then {len(wrong)} of {len(cycles)}", flush=True)
        if cycles and not wrong:
            return 0
        if not stalls:
            print(f"failed: {name}: {wrong[:3] or 'no cycles'}")
            return 1
        print(f"  the machine stalled, {max(stalls) * 1e3:.0f} ms at most: once more")
        words = []
    return 75


def between_two_cuts(ring):
    """What has to show, does."""
    changed = time.monotonic()
    ring.control("pull", CABLES[3])
    time.sleep(SETTLED + WATCHED)
    cycles, wrong = ring.between(changed + SETTLED, changed + SETTLED + WATCHED)
    print(f"{'two cables pulled':<20} {len(wrong)} of {len(cycles)} cycles not whole, as it has to be")
    if not cycles or len(wrong) < len(cycles):
        print("failed: devices between two cuts seem to answer")
        return 1
    return 0


def conduct(ring, summary):
    """One MainDevice, of which nothing is told twice."""
    fell = [event for event in ring.events if event.get("event") == "state" and event["code"]]
    sessions = summary["sessions"]
    began = [event for event in ring.events if event.get("event") == "session began"]
    # Those between two cuts fell by their watchdogs, and no other device.
    fell = {event["position"] for event in fell} - {1, 2}
    cycles = sessions[0]["cycle"]["interval"] if sessions and sessions[0]["cycle"] else {}
    mean = cycles.get("mean_ns", 0) / 1e3
    # Where nothing comes back at one port, SOEM waits for it in each cycle.
    own = (ring.cycles[-1]["at"] - ring.cycles[0]["at"]) / (len(ring.cycles) - 1) * 1e6
    print(f"sessions: {len(began)}, sources: {sessions[0]['sources'] if sessions else '-'}, mean cycle {mean:.0f} us of {own:.0f} us, "
          f"{sessions[0]['frames'] if sessions else 0} frames, {sessions[0]['second_port_frames'] if sessions else 0} at the second port")
    problems = []
    if len(began) != 1 or len(sessions) != 1 or len(sessions[0]["sources"]) != 1:
        problems.append("more than one MainDevice seems to have been there")
    if fell:
        problems.append(f"devices left OP that frames came to: {sorted(fell)}")
    if abs(mean - own) > own / 20:
        problems.append(f"a cycle of {own:.0f} us is told as {mean:.0f} us")
    if sessions and not sessions[0]["second_port_frames"]:
        problems.append("nothing came in at the second port")
    for problem in problems:
        print(f"failed: {problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
