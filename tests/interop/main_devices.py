#!/usr/bin/env python3
"""Foreign MainDevices, unmodified, against `isocat serve`: pysoem (SOEM), kickcat (KickCAT) and ethercrab.

Each of them meets each segment in a network namespace that `isocat serve --setup-veth` makes for it, and goes through the
steps of peer.py; then it comes to OP, is killed there, and another one has to come to OP. tshark looks at every frame. At the
end there is a table, and what the served segment says about each MainDevice.

    main_devices.py [--isocat PATH] [--only PEER] [--segment NAME] [--cycles N] [--keep] [--broken]

Real time on a shared machine: witness.py sees when the machine stalls, and verdict.py judges whether a failure is that, by evidence.
Only then is a MainDevice tried again; what fails otherwise has failed. --broken shows that it can: segments that are wrong on
purpose have to fail, each in its step.

Needs root, `ip`, tshark with dumpcap, and a package index for what it installs into the target directory; a MainDevice that
can't be installed is skipped. Exit codes: 0 all well, 1 something failed, 75 nothing failed but the machine was too late for
some of it in each attempt, 77 nothing could be tried.
"""
import argparse
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from verdict import late_requests, lateness
from witness import Witness

try:
    import tomllib
except ImportError:
    print("skipped: Python 3.11 is missing")
    sys.exit(77)

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
TOOLS = TARGET / "interop"
PACKAGES = {"pysoem": "pysoem==1.1.13", "kickcat": "kickcat==2.5"}

SIMPLE = 'cycle = "1ms"\n[[subdevice]]\ndevice = "simple_io16"\ncount = {}\n'
# name: segment file (None: the built-in one), cycle, positions that get SYNC0, SDOs to write
SEGMENTS = {
    "4 simple": (SIMPLE.format(4), 1000, range(4), {}),
    # A cycle that forgives late frames of some ms: drives take two missed SM events in a row for a
    # fault. By default nothing is assigned in device 3, as in its maker's file.
    "built-in": (None, 8000, [0, 1, 4], {4: [(0x1C12, 0x1600), (0x1C13, 0x1A00)]}),
    "50 simple": (SIMPLE.format(50), 1000, [], {}),
}
# As above, with a fault that no MainDevice may get past, and the step that has to fail for it.
BROKEN = {
    "refuses OP": (SIMPLE.format(2) + 'misbehave = ["refused-state OP"]\n', 1000, [], {}, "op"),
    "says another time": ('cycle = "4ms"\n[[subdevice]]\ndevice = "kollmorgen_akd2g"\nmisbehave = ["wrong-value 1C32:06 7"]\n',
                          4000, [0], {}, "sdo"),
    "copies every other output": ('cycle = "1ms"\n[[subdevice]]\ndevice = "simple_io16"\ncount = 2\n'
                                  'misbehave = ["missed-copy 2"]\n', 1000, [], {}, "cycles"),
}
STEPS = ["scan", "preop", "sdo", "map", "dc", "safeop", "op", "cycles", "down", "again", "wire"]
TIMES = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
SIZES = {"UNSIGNED8": 1, "BOOLEAN": 1, "UNSIGNED16": 2, "UNSIGNED32": 4}
# Of 0x1C32 and 0x1C33: sub-indices whose values do not depend on what was before.
CONSTANT = {0x00, 0x04, 0x05, 0x06, 0x07, 0x09}
WATCHDOG_MS = 1000
# Seconds of cycles at most.
LONGEST = 20
ATTEMPTS = 3
# Before everybody else on the machine: a late frame is a missed SM event.
PROMPT = ["chrt", "--fifo", "50"] if shutil.which("chrt") else []


def main():
    arguments = parse()
    for what, missing in [("root", os.geteuid() != 0), ("ip", not shutil.which("ip")),
                          ("tshark", not (shutil.which("tshark") and shutil.which("dumpcap")))]:
        if missing:
            print(f"skipped: {what} is missing")
            return 77
    peers = install([arguments.only] if arguments.only else ["pysoem", "kickcat", "ethercrab"])
    if not peers:
        return 77
    folder = Path(tempfile.mkdtemp(prefix="isocat-interop-"))
    try:
        with Witness(folder) as witness:
            if arguments.broken:
                return broken(arguments, folder, peers, witness)
            rows = {}
            for name in [arguments.segment] if arguments.segment else SEGMENTS:
                cycles = min(arguments.cycles, LONGEST * 1_000_000 // SEGMENTS[name][1])
                segment = Segment(arguments.isocat, folder, name, cycles)
                for peer, command in peers.items():
                    rows[peer, name] = attempts(arguments.isocat, folder, peer, command, segment, witness)
            stalls = witness.stalls()
        # Last, so that it disturbs nobody.
        for row in rows.values():
            row.judge_wire()
        show(rows, stalls)
        return outcome(rows)
    finally:
        if arguments.keep:
            print(f"captures and summaries stay in {folder}")
        else:
            shutil.rmtree(folder)


def parse():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--only", choices=["pysoem", "kickcat", "ethercrab"])
    parser.add_argument("--segment", choices=list(SEGMENTS))
    parser.add_argument("--cycles", type=int, default=5000)
    parser.add_argument("--broken", action="store_true", help="segments that have to fail")
    parser.add_argument("--keep", action="store_true", help="keep captures and summaries")
    return parser.parse_args()


def install(names):
    """Commands of the MainDevices that are there."""
    peers, python = {}, TOOLS / "venv" / "bin" / "python"
    for name in names:
        if name == "ethercrab":
            build = ["cargo", "build", "--quiet", "--locked", "--manifest-path", HERE / "ethercrab" / "Cargo.toml"]
            done = subprocess.run(build, env=os.environ | {"CARGO_TARGET_DIR": str(TOOLS)}, capture_output=True, text=True)
            command = [TOOLS / "debug" / "interop-ethercrab"]
        else:
            if not python.exists():
                subprocess.run([sys.executable, "-m", "venv", TOOLS / "venv"], check=True)
            pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", PACKAGES[name]]
            done = subprocess.run(pip, capture_output=True, text=True)
            command = [python, HERE / f"peer_{name}.py"]
        if done.returncode == 0:
            peers[name] = command
        else:
            print(f"skipped: {name} can't be installed: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return peers


def outcome(rows):
    """The exit code."""
    cells = [cell for row in rows.values() for cell in row.cells.values()]
    if any(cell.failed for cell in cells):
        return 1
    return 75 if any(cell.result == "late" for cell in cells) else 0


def broken(arguments, folder, peers, witness):
    """Whether what has to fail does, in its step; lateness would be no failure."""
    wrong = 0
    for name, (*_, step) in BROKEN.items():
        segment = Segment(arguments.isocat, folder, name, 1000)
        for peer, command in peers.items():
            row = attempts(arguments.isocat, folder, peer, command, segment, witness)
            row.judge_wire()
            cell = row.cells.get(step)
            right = outcome({(peer, name): row}) == 1 and cell is not None and cell.failed
            wrong += not right
            said = {step: cell.result for step, cell in row.cells.items()}
            print(f"{peer} at a segment that {name}: {'fails in ' + step + ', as it has to' if right else f'NOT FAILED: {said}'}")
    return 1 if wrong else 0


class Segment:
    """A segment file and what a MainDevice should find in it."""

    def __init__(self, isocat, folder, name, cycles, drift_frames=0):
        self.name = name
        text, cycle_us, sync0, startup = SEGMENTS[name] if name in SEGMENTS else BROKEN[name][:4]
        self.file = None
        if text:
            self.file = folder / f"{name.replace(' ', '-')}.toml"
            self.file.write_text(text)
        else:
            text = run(isocat, "example")
        self.cycle = cycle_us / 1e6
        devices = []
        for entry in tomllib.loads(text)["subdevice"]:
            profile = tomllib.loads(run(isocat, "devices", entry["device"]))
            for _ in range(entry.get("count", 1)):
                position = len(devices)
                devices.append(describe(profile, position, position in sync0, startup.get(position, [])))
        self.drives = any(device["application"] != "io" for device in devices)
        self.task = folder / f"{name.replace(' ', '-')}.json"
        # Frames with the reference's time before SYNC is switched on, 1 ms apart, beside those that
        # a MainDevice sends by itself.
        task = {"cycle_us": cycle_us, "cycles": cycles, "watchdog_ms": WATCHDOG_MS, "drift_frames": drift_frames, "devices": devices}
        self.task.write_text(json.dumps(task))
        self.seconds = cycles * cycle_us / 1e6


def run(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def describe(profile, position, sync0, assigned):
    identity = profile["identity"]
    entries = []
    for described in profile.get("object", []):
        if described["index"] not in (0x1C32, 0x1C33):
            continue
        for entry in described["entries"]:
            if isinstance(entry, list):
                sub, kind, _, value, _ = entry
                constant = nanoseconds(value) if sub in CONSTANT else None
                entries.append([described["index"], sub, SIZES[kind], constant])
    startup = []
    for index, pdo in assigned:
        startup += [[index, 0, 1, 0], [index, 1, 2, pdo], [index, 0, 1, 1]]
    lengths = []
    for side, index in [("outputs", 0x1C12), ("inputs", 0x1C13)]:
        described = profile.get(side, {"default": [], "pdo": []})
        pdos = [pdo for at, pdo in assigned if at == index] or described["default"]
        bits = sum(BITS[kind] for pdo in described["pdo"] if pdo["index"] in pdos for _, kind, _ in pdo["entries"])
        lengths.append(bits // 8)
    return {
        "name": f"{profile['name']} {position}", "vendor": identity["vendor_id"], "product": identity["product_code"],
        "revision": identity["revision"], "outputs": lengths[0], "inputs": lengths[1], "mailbox": "mailbox" in profile,
        "sync0": sync0, "application": profile["application"], "entries": entries, "startup": startup,
    }


BITS = {"UNSIGNED8": 8, "INTEGER8": 8, "UNSIGNED16": 16, "INTEGER32": 32}


def nanoseconds(value):
    if not isinstance(value, str):
        return value
    number = value.rstrip("nums")
    return round(float(number) * TIMES[value[len(number):]])


class Cell:
    """How a step went, and from when to when, if it took place in time."""

    def __init__(self, result, what="", began=None, ended=None):
        self.result, self.what, self.began, self.ended = result, what, began, ended

    @property
    def failed(self):
        return self.result == "failed"


class Row:
    """One MainDevice at one segment."""

    def __init__(self, capture):
        self.cells, self.capture, self.summary, self.repeated = {}, capture, "", []
        # (time, AL status code) of SubDevices that refused a state or left it.
        self.refusals = []

    def take(self, steps):
        for step in steps:
            self.cells[step["step"]] = Cell(step["result"], step["what"], step["began"], step["ended"])

    def excuse(self, peer, segment, stalls):
        """Makes failures that are lateness of the machine `late`, if every failure is one."""
        failed = [cell for cell in self.cells.values() if cell.failed]
        if failed and self.capture.exists():
            stalls = sorted([*stalls, *late_requests(self.frames(), segment.cycle)])
        why = [cell.began and lateness(peer, (cell.what, cell.began, cell.ended), stalls, self.refusals, segment.cycle, segment.drives)
               for cell in failed]
        if all(why):
            for cell, reason in zip(failed, why):
                cell.result, cell.what = "late", f"{cell.what} ({reason})"

    def frames(self):
        """(time on the monotonic clock, whether it is an answer) of each frame: the first SubDevice marks the source address."""
        epoch = time.time() - time.monotonic()
        lines = run("tshark", "-r", self.capture, "-T", "fields", "-e", "frame.time_epoch", "-e", "eth.src").splitlines()
        fields = [line.split("\t") for line in lines]
        return [(float(at) - epoch, bool(int(source[:2], 16) & 2)) for at, source in fields]

    def judge_wire(self):
        # One line for every frame that tshark does not read as EtherCAT, or finds bad.
        bad = "!ecat || _ws.malformed || _ws.expert.severity >= 8388608"
        command = ["nice", "tshark", "-r", self.capture, "-Y", bad, "-T", "fields", "-e", "frame.number", "-e", "_ws.col.Info"]
        lines = run(*command).splitlines()
        counted = run("capinfos", "-Mc", self.capture).split(":")[-1].strip()
        if lines or not int(counted):
            self.cells["wire"] = Cell("failed", f"{len(lines)} of {counted} frames: {lines[:3]}")
        else:
            self.cells["wire"] = Cell("ok", f"{counted} frames")


def attempts(isocat, folder, peer, command, segment, witness):
    repeated = []
    for number in range(ATTEMPTS):
        print(f"{peer} at {segment.name}{f', attempt {number + 1}' if number else ''} ...", flush=True)
        row = attempt(isocat, folder, peer, command, segment, number)
        row.repeated = repeated
        row.excuse(peer, segment, witness.stalls())
        bad = [f"{step}: {cell.result}: {cell.what}" for step, cell in row.cells.items() if cell.result in ("failed", "late")]
        if bad:
            print("  " + "; ".join(bad), flush=True)
        # Again only for what the machine was late for.
        if not bad or any(cell.failed for cell in row.cells.values()):
            break
        repeated = [*repeated, "; ".join(bad)]
    return row


def attempt(isocat, folder, peer, command, segment, number):
    namespace = f"isoit{os.getpid() % 100_000}"
    stem = folder / f"{peer}-{segment.name.replace(' ', '-')}-{number}"
    report, capture = stem.with_suffix(".txt"), stem.with_suffix(".pcapng")
    row = Row(capture)
    serve = [isocat, "serve", *([segment.file] if segment.file else []), "--setup-veth", namespace, "--report", report, "--json"]
    inside = ["ip", "netns", "exec", namespace]
    server = subprocess.Popen(PROMPT + serve, stdout=subprocess.PIPE, text=True)
    try:
        greeting = json.loads(server.stdout.readline())
        serving = time.monotonic()
        assert greeting["event"] == "serving", greeting
        # What it says meanwhile must not fill the pipe.
        with open(stem.with_suffix(".jsonl"), "w") as lines:
            copier = subprocess.Popen(["cat"], stdin=server.stdout, stdout=lines)
        sniff = ["dumpcap", "-q", "-B", "64", "-i", namespace, "-f", "ether proto 0x88a4", "-w", capture]
        sniffer = subprocess.Popen(inside + sniff, stderr=subprocess.PIPE, text=True)
        try:
            # Its first line says that it captures.
            sniffer.stderr.readline()
            row.take(session(inside, command, namespace, segment, "whole"))
            # The segment tells sessions apart by the pause between them.
            time.sleep(0.5)
            row.cells["again"] = again(inside, command, namespace, segment)
        finally:
            sniffer.send_signal(signal.SIGINT)
            sniffer.communicate(timeout=20)
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(20)
    copier.wait(20)
    row.summary = report.read_text()
    row.refusals = refusals(stem.with_suffix(".jsonl").read_text(), serving)
    if server.returncode != 0:
        row.cells["again"] = Cell("failed", f"isocat serve ended with {server.returncode}")
    return row


def refusals(lines, serving):
    """When SubDevices refused a state or left one, and their AL status codes; `serving` is when the service said that it begins."""
    events = [json.loads(line) for line in lines.splitlines() if line.startswith('{"')]
    return [(serving + event["at_ns"] / 1e9, event["code"]) for event in events if event.get("event") == "state" and event["code"]]


def again(inside, command, namespace, segment):
    """Killed in OP; a second one comes when the watchdogs have found out."""
    held = session(inside, command, namespace, segment, "hold")
    last = held[-1]
    if last["step"] != "op" or last["result"] != "ok":
        return Cell("failed", last["what"] or "no step", last["began"], last["ended"])
    time.sleep(WATCHDOG_MS / 1000 + 0.3)
    last = session(inside, command, namespace, segment, "again")[-1]
    if last["result"] == "failed" or last["step"] != "down":
        return Cell("failed", last["what"] or f"ended after {last['step']}", last["began"], last["ended"])
    return Cell("ok")


def session(inside, command, namespace, segment, role):
    """Its steps, one at least, each with its begin and end. In the role `hold` it is killed half a second after it came to OP."""
    errors = tempfile.TemporaryFile("w+")
    began = time.monotonic()
    peer = subprocess.Popen([*inside, *PROMPT, *command, namespace, segment.task, role], stdout=subprocess.PIPE, stderr=errors)
    deadline = began + 30 + 2 * segment.seconds
    steps, text = [], b""

    def take(step):
        steps.append(step | {"began": steps[-1]["ended"] if steps else began, "ended": time.monotonic()})

    def failed(step, what):
        take({"step": step, "result": "failed", "what": what})

    while time.monotonic() < deadline:
        if not select.select([peer.stdout], [], [], 0.5)[0]:
            continue
        piece = os.read(peer.stdout.fileno(), 65536)
        if not piece:
            break
        text += piece
        *lines, text = text.split(b"\n")
        for line in lines:
            if line.startswith(b"{"):
                take(json.loads(line))
        if role == "hold" and steps and steps[-1]["step"] == "op" and steps[-1]["result"] == "ok":
            time.sleep(0.5)
            if peer.poll() is not None:
                failed("hold", "ended by itself")
            break
    else:
        failed(following(steps), "took too long")
    peer.kill()
    peer.wait()
    if peer.returncode not in (0, -signal.SIGKILL):
        errors.seek(0)
        said = errors.read().strip().splitlines()
        if not steps or steps[-1]["result"] != "failed":
            failed(following(steps), f"exit code {peer.returncode}")
        steps[-1]["what"] += f" [{said[-1]}]" if said else ""
    if not steps:
        failed("scan", "ended without a word")
    return steps


def following(steps):
    """The step that a session was in after these."""
    return STEPS[STEPS.index(steps[-1]["step"]) + 1] if steps else "scan"


def show(rows, stalls):
    """The table, then what it needs words for, then what the segment says of each MainDevice."""
    titles = {"again": "after kill", "wire": "tshark", "cycles": "process data"}
    columns = [titles.get(step, step) for step in STEPS]
    widths = [max(len(column), 6) for column in columns]
    print(f"\n{'MainDevice':<11}{'segment':<11}" + "  ".join(f"{c:<{w}}" for c, w in zip(columns, widths)))
    for (peer, segment), row in rows.items():
        cells = [row.cells.get(step, Cell("-")).result for step in STEPS]
        print(f"{peer:<11}{segment:<11}" + "  ".join(f"{c:<{w}}" for c, w in zip(cells, widths)).rstrip())
    print("\n-: not tried, since a step before it failed; late: the machine was, in each attempt")
    longest = max((length for _, length in stalls), default=0) * 1e3
    print(f"stalls of the machine of more than 1 ms: {len(stalls)}, longest {longest:.0f} ms")
    for (peer, segment), row in rows.items():
        print(f"\n{peer} at {segment}:")
        for number, failed in enumerate(row.repeated[:ATTEMPTS - 1]):
            print(f"  attempt {number + 1} of {ATTEMPTS} was repeated: {failed}")
        for step in STEPS:
            cell = row.cells.get(step)
            if cell and cell.what:
                print(f"  {step}: {cell.result}: {cell.what}")
    for (peer, segment), row in rows.items():
        print(f"\n== what the served segment says of {peer} at {segment}: left out, or done badly (first session)")
        print(remarks(row.summary))


def remarks(summary):
    head = " what it left out, or did badly\n"
    before, found, rest = summary.partition(head)
    return rest.split("\nSession ")[0].split("\n\n")[0].rstrip() if found else "  no summary"


if __name__ == "__main__":
    sys.exit(main())
