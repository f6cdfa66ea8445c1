#!/usr/bin/env python3
"""`isocat record` beside a MainDevice, in a network namespace of its own: `isocat serve` has the segment, pysoem drives it (or `isocat run`, where
pysoem is missing: then the way back alone is heard), a cable is pulled, and the file that is written has it: `isocat diagnose` finds the fault,
and tshark shows the comment. Also: SIGUSR1, a full disk, `diagnose --interface` now, and what `serve --record` writes.

Needs root, ip, tshark. Exit codes: 0 all well, 1 something is wrong, 77 could not be tried.
"""
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from main_devices import TOOLS

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
NAME = f"isctrec{os.getpid() % 1000}"
SEGMENT = """
cycle = "4ms"
[[subdevice]]
device = "simple_io16"
name = "io 1"
[[subdevice]]
device = "simple_io16"
name = "io 2"
[[subdevice]]
device = "simple_io16"
name = "io 3"
"""
# The cable before io 2 is pulled: what is behind it is missing.
EXPECTED = {"devices-vanished", "working-counter"}
PATIENCE = 60


class Failed(Exception):
    pass


def isocat():
    if "ISOCAT" in os.environ:
        return os.environ["ISOCAT"].split()
    subprocess.run(["cargo", "build", "--release", "--locked", "--quiet", "--bin", "isocat"], cwd=ROOT, check=True)
    return [str(TARGET / "release" / "isocat")]


def drive(interface, seconds):
    """pysoem in OP, a cycle each 4 ms; states are read now and then, as applications do."""
    import pysoem
    pysoem.settings.timeouts.ret = 100_000
    main_device = pysoem.Master()
    main_device.open(interface)
    if main_device.config_init() != 3:
        sys.exit("pysoem does not find three SubDevices")
    main_device.config_map()
    main_device.state_check(pysoem.SAFEOP_STATE, 1_000_000)
    for device in main_device.slaves:
        device.set_watchdog("processdata", 1000)
    end, cycles = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        main_device.send_processdata()
        main_device.receive_processdata(4_000)
        cycles += 1
        if cycles % 25 == 0:
            main_device.state_check(pysoem.OP_STATE, 0)
        if cycles % 25 == 12:
            bring_back(main_device, pysoem)
        time.sleep(0.004)
    main_device.close()


def bring_back(main_device, pysoem):
    main_device.read_state()
    for device in main_device.slaves:
        if device.state == pysoem.SAFEOP_STATE + pysoem.STATE_ERROR:
            device.state = pysoem.SAFEOP_STATE + pysoem.STATE_ACK
            device.write_state()
        elif device.state == pysoem.SAFEOP_STATE:
            device.state = pysoem.OP_STATE
            device.write_state()


class Lines:
    """A program that prints a JSON document a line."""

    def __init__(self, command, log):
        self.log = open(log, "w+")
        self.process = subprocess.Popen(command, stdout=self.log, stderr=subprocess.STDOUT)
        self.path = log

    def events(self):
        lines = Path(self.path).read_text().splitlines()
        return [json.loads(line) for line in lines if line.startswith("{")]

    def wait(self, what, holds):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            found = [event for event in self.events() if holds(event)]
            if found:
                return found
            if self.process.poll() is not None:
                break
            time.sleep(0.05)
        raise Failed(f"{what} did not come:\n{Path(self.path).read_text()}")

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


def same(what, found, expected):
    if found != expected:
        raise Failed(f"{what}: found {found}, expected {expected}")
    print(f"ok: {what}: {found}")


def comments(file):
    command = ["tshark", "-r", file, "-Y", "frame.comment", "-T", "fields", "-e", "frame.number", "-e", "frame.comment"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return [line.split("\t") for line in text.splitlines()]


def diagnose(program, *more):
    done = subprocess.run([*program, "diagnose", *more, "--json"], capture_output=True, text=True)
    if done.returncode not in (0, 1, 3):
        raise Failed(f"diagnose {more}: exit {done.returncode}: {done.stderr}")
    return json.loads(done.stdout)


def look_at(program, file, kinds, both):
    """What is in a file that was written for these kinds."""
    report = diagnose(program, file)
    found = {finding["kind"] for finding in report["findings"]}
    wanted = set(kinds) & EXPECTED
    same(f"diagnose finds in {file.name}", sorted(found & wanted), sorted(wanted))
    same("both directions are in it" if both else "the way back is in it", report["tap"]["seen"], "both" if both else "back")
    shown = comments(file)
    same("tshark shows each reason", sorted(kind for kind in set(kinds) if any(f"isocat: {kind}: " in words for _, words in shown)),
         sorted(set(kinds)))
    vanished = [finding["frame"] for finding in report["findings"] if finding["kind"] == "devices-vanished"]
    marked = [int(number) for number, words in shown if "devices-vanished" in words]
    if vanished and vanished[:1] != marked[:1]:
        raise Failed(f"the comment stands at frame {marked}, diagnose says {vanished}")


def main():
    for command in ["ip", "tshark"]:
        if not shutil.which(command):
            print(f"skipped: {command} is missing")
            return 77
    if os.geteuid() != 0:
        print("skipped: it needs root for a network namespace")
        return 77
    program = isocat()
    python = with_pysoem()
    if python is None:
        print("pysoem is missing: isocat run drives the segment, of which the way back alone is heard")
    with tempfile.TemporaryDirectory() as folder:
        try:
            return tried(program, Path(folder), python)
        except Failed as failed:
            print(f"FAILED: {failed}", file=sys.stderr)
            return 1


def with_pysoem():
    """An interpreter that has pysoem: this one, or that of the other tests with foreign MainDevices."""
    for python in [sys.executable, TOOLS / "venv" / "bin" / "python"]:
        if Path(python).exists() and subprocess.run([python, "-c", "import pysoem"], capture_output=True).returncode == 0:
            return python
    return None


def tried(program, folder, python):
    both = python is not None
    segment, disk = folder / "segment.toml", folder / "disk"
    segment.write_text(SEGMENT)
    disk.mkdir()
    keys = ["--keep", "3s", "--after", "1s"]
    running = []

    def start(command, log):
        running.append(Lines(command, folder / log))
        return running[-1]

    inside = ["ip", "netns", "exec", NAME]
    full = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8k", "tmpfs", disk], capture_output=True).returncode == 0
    try:
        serve = start([*program, "serve", segment, "--setup-veth", NAME, "--json", "--record", folder / "served", *keys], "serve.log")
        serve.wait("the segment", lambda event: event["event"] == "serving")
        listen = [*program, "record", "--interface", NAME, "--netns", NAME, "--json", *keys]
        record = start([*listen, "--into", folder / "files"], "record.log")
        record.wait("the recorder", lambda event: event["event"] == "listening")
        if full:
            crowded = start([*listen, "--into", disk, "--on", "signal"], "crowded.log")
            crowded.wait("the recorder", lambda event: event["event"] == "listening")
        if both:
            driver = [*inside, python, Path(__file__).resolve(), "--drive", NAME, "300"]
        else:
            driver = [*program, "run", segment, "--interface", NAME, "--netns", NAME, "--for", "5min"]
        driver = start(driver, "driver.log")
        serve.wait("operation", lambda event: event["event"] == "in operation")
        time.sleep(3)

        live = diagnose(program, "--interface", NAME, "--netns", NAME, "--for", "2s")
        same("diagnose --interface sees", live["tap"]["seen"], "both" if both else "back")
        if live["cycle"] is None or live["captures"][0]["packets"] < 100:
            raise Failed(f"diagnose --interface saw no cycle: {live['frames']}")

        before = len(record.events())
        subprocess.run([*program, "control", f"{NAME}-seg", "pull", "io 2"], check=True, stdout=subprocess.DEVNULL)
        record.wait("the pulled cable", lambda event: event["event"] == "happened" and event["kind"] == "devices-vanished")
        reasons = [event["kind"] for event in record.events()[before:] if event["event"] == "happened"]
        print(f"ok: record noticed {reasons}")
        subprocess.run([*program, "control", f"{NAME}-seg", "plug", "io 2"], check=True, stdout=subprocess.DEVNULL)
        [written, *_] = record.wait("its file", lambda event: event["event"] == "written" and "devices-vanished" in event["kinds"])
        look_at(program, Path(written["file"]), written["kinds"], both)
        [served, *_] = serve.wait("the file of serve", lambda event: event["event"] == "written" and "devices-vanished" in event["kinds"])
        look_at(program, Path(served["file"]), served["kinds"], True)

        record.process.send_signal(signal.SIGUSR1)
        [asked, *_] = record.wait("the file of SIGUSR1", lambda event: event["event"] == "written" and "signal" in event["kinds"])
        shown = [words for _, words in comments(asked["file"]) if "isocat: signal" in words]
        same("its comment", len(shown), 1)
        if full:
            for times in [1, 2]:
                crowded.process.send_signal(signal.SIGUSR1)
                crowded.wait(f"word of the full disk, {times}",
                             lambda event: len([one for one in crowded.events() if one["event"] == "failed"]) >= times)
            same("it listens on beside a full disk", crowded.process.poll(), None)
            same("a full disk has no half of a file", list(disk.iterdir()), [])
            same("exit code beside a full disk", crowded.end(), 2)
        else:
            print("the full disk is left out: mount is not permitted")
        same("exit code of record", record.end(), 1)
        last = record.events()[-1]
        same("its last line", last["event"], "ended")
        print(f"ok: {last['frames']} frames heard, {last['not_heard']} not heard")
        parts = [path.name for path in (folder / "files").iterdir() if path.suffix != ".pcapng"]
        same("what is left beside captures", parts, [])
        if driver.process.poll() is not None:
            raise Failed(f"the MainDevice ended early: {(folder / 'driver.log').read_text()}")
        # How it ends is not tried here, and an interrupt within its library's loops may be lost.
        driver.process.kill()
        driver.process.wait(PATIENCE)
        recorded_run(program, segment, folder, keys)
    finally:
        for one in reversed(running):
            if one.process.poll() is None:
                one.process.send_signal(signal.SIGINT)
                try:
                    one.process.wait(PATIENCE)
                except subprocess.TimeoutExpired:
                    one.process.kill()
        if full:
            subprocess.run(["umount", disk], capture_output=True)
    return 0


def recorded_run(program, segment, folder, keys):
    """A run on the wire that records itself."""
    command = [*program, "run", segment, "--interface", NAME, "--netns", NAME, "--for", "5s", "--json", "--record", folder / "run", *keys]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    subprocess.run(["sleep", "3.5"], check=True)
    for order in ["pull", "plug"]:
        subprocess.run([*program, "control", f"{NAME}-seg", order, "io 2"], check=True, stdout=subprocess.DEVNULL)
        time.sleep(0.5)
    out, errors = run.communicate(timeout=PATIENCE)
    files = sorted((folder / "run").iterdir())
    if not files:
        raise Failed(f"run --record wrote nothing: {errors}")
    notes = json.loads(out)["notes"]
    same("files in the notes of the run", [any(file.name in note for note in notes) for file in files], [True] * len(files))
    reports = [diagnose(program, file) for file in files]
    same("both directions are in them", {report["tap"]["seen"] for report in reports}, {"both"})
    found = {finding["kind"] for report in reports for finding in report["findings"]}
    same("diagnose finds in the file of a run", sorted(found & {"devices-vanished"}), ["devices-vanished"])


if __name__ == "__main__":
    if sys.argv[1:2] == ["--drive"]:
        drive(sys.argv[2], float(sys.argv[3]))
    else:
        sys.exit(main())
