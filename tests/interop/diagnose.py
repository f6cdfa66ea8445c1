#!/usr/bin/env python3
"""A foreign witness for `isocat diagnose`: what it says of a capture, tshark says of the same frames. Compared are the number of
frames, drift frames, AL status and codes in the frames that are named, switches of SYNC units with their words, start times and
cycles, propagation delays, SDO values and aborts. tshark shows the comments of an annotated copy at the frames of the findings. Captures are those of runs with faults, and those of real segments in
../shared/captures (or $ISOCAT_SHARED) where they are there.

Needs tshark. Exit codes: 0 all well, 1 something differs, 77 could not be tried.
"""
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
RUNS = ["stall", "pull", "al-error", "double", "drop"]
FIELDS = ["frame.number", "eth.src", "ecat.cmd", "ecat.ado", "ecat.adp", "ecat.cnt", "ecat.reg.alstatus",
          "ecat.reg.alstatuscode", "ecat.reg.dc.activation", "ecat.reg.dc.starttime0", "ecat.reg.dc.cyctime0",
          "ecat.reg.dc.systimedelay", "ecat_mailbox.coe.sdoidx", "ecat_mailbox.coe.abortcode", "ecat_mailbox.coe.sdodata"]


def isocat():
    if "ISOCAT" in os.environ:
        return os.environ["ISOCAT"].split()
    subprocess.run(["cargo", "build", "--release", "--locked", "--quiet", "--bin", "isocat"], cwd=ROOT, check=True)
    return [str(TARGET / "release" / "isocat")]


def frames(capture):
    """What tshark shows of each EtherCAT frame, by number: lists of numbers by field."""
    command = ["tshark", "-r", capture, "-Y", "ecat", "-T", "fields"]
    for field in FIELDS:
        command += ["-e", field]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = {}
    for line in text.splitlines():
        cells = dict(zip(FIELDS, line.split("\t")))
        found[int(cells["frame.number"])] = {
            field: [number(one) for one in cell.split(",") if one] if field != "eth.src" else cell
            for field, cell in cells.items()}
    return found


def number(text):
    try:
        return int(text, 0)
    except ValueError:
        return text


class Witness:
    def __init__(self, name, report, shown):
        self.name, self.report, self.shown, self.compared, self.wrong = name, report, shown, 0, 0

    def same(self, what, ours, theirs):
        self.compared += 1
        if ours != theirs:
            self.wrong += 1
            print(f"FAILED: {self.name}: {what}: isocat {ours}, tshark {theirs}", file=sys.stderr)

    def has(self, what, frame, field, value):
        """A frame has this value in one of its datagrams."""
        theirs = self.shown.get(frame, {}).get(field, [])
        self.same(f"{what}, frame {frame}", value in theirs and value, value)

    def all(self):
        report, frames = self.report, self.report["frames"]
        ours = 2 * frames["pairs"] + sum(frames[key] for key in
                                         ["unanswered", "answers_alone", "duplicates", "elsewhere", "broken"])
        self.same("EtherCAT frames", ours, len(self.shown))
        # Answers alone have no sent frame to count.
        whole = not frames["duplicates"] and not frames["answers_alone"]
        if report["clock"] and report["tap"]["seen"] == "both" and whole:
            code = {"FRMW": 0x0E, "ARMW": 0x0D}[report["clock"]["command"]]
            sent = [one for one in self.shown.values() if not int(one["eth.src"][:2], 16) & 2]
            drift = sum(sum(cmd == code for cmd in one["ecat.cmd"]) for one in sent)
            self.same("drift frames", report["clock"]["frames"], drift)
            self.has("last drift frame", report["clock"]["last"]["frame"], "ecat.cmd", code)
        for device in report["devices"]:
            self.device(device)

    def device(self, device):
        name = device["name"] or device["position"]
        for state in device["states"]:
            self.has(f"{name}: AL status", state["frame"], "ecat.reg.alstatus", state["raw"])
        for sync in device["sync"]:
            shown = self.shown.get(sync["frame"], {})
            ados = [ado for ado in shown.get("ecat.ado", []) if ado in (0x0980, 0x0981)]
            self.same(f"{name}: SYNC switched in frame {sync['frame']}", bool(ados), True)
            if shown.get("ecat.reg.dc.activation"):
                self.has(f"{name}: activation", sync["frame"], "ecat.reg.dc.activation", sync["assign_activate"] >> 8)
            if sync["start_bytes"] == 8 and sync["start_ns"]:
                start = sync["start_ns"]
                theirs = self.shown.get(start["frame"], {}).get("ecat.reg.dc.starttime0")
                if theirs:
                    self.has(f"{name}: start time", start["frame"], "ecat.reg.dc.starttime0", start["value"])
            if sync["sync0_cycle_ns"]:
                cycle = sync["sync0_cycle_ns"]
                self.has(f"{name}: SYNC0 cycle", cycle["frame"], "ecat.reg.dc.cyctime0", cycle["value"])
        if device["delay_ns"] and self.shown.get(device["delay_ns"]["frame"], {}).get("ecat.reg.dc.systimedelay"):
            delay = device["delay_ns"]
            self.has(f"{name}: delay", delay["frame"], "ecat.reg.dc.systimedelay", delay["value"])
        mailbox = device["mailbox"]
        for abort in mailbox["aborts"] if mailbox else []:
            self.has(f"{name}: abort", abort["frame"], "ecat_mailbox.coe.abortcode", abort["code"])
            # Of an abort tshark shows the code alone; the object stands in the request, some frames before it.
            before = [self.shown.get(frame, {}) for frame in range(abort["frame"] - 64, abort["frame"])]
            index = int(abort["object"][:6], 0)
            asked = [one for shown in before for one in shown.get("ecat_mailbox.coe.sdoidx", [])]
            self.same(f"{name}: object of the abort in frame {abort['frame']}", index in asked and index, index)
        for value in mailbox["sync_objects"] if mailbox else []:
            self.has(f"{name}: {value['object']}", value["frame"], "ecat_mailbox.coe.sdoidx", value["index"])
            data = self.shown.get(value["frame"], {}).get("ecat_mailbox.coe.sdodata")
            if data and not value["written"]:
                theirs = {one & 0xFFFF if value["sub"] in (1, 4, 8, 0x0B, 0x0C, 0x0D, 0x0E) else one for one in data}
                self.same(f"{name}: value of {value['object']}", value["value"] in theirs and value["value"], value["value"])


def comments(program, captures, folder):
    """tshark shows each finding's comment at its frame of an annotated copy; gives how many were compared and how many are not there."""
    copy = Path(folder) / "annotated.pcapng"
    done = subprocess.run([*program, "diagnose", *captures, "--annotate", copy, "--json"], capture_output=True, text=True)
    report = json.loads(done.stdout)
    text = subprocess.run(["tshark", "-r", copy, "-Y", "frame.comment", "-T", "fields", "-e", "frame.number", "-e", "frame.comment"],
                          capture_output=True, text=True, check=True).stdout
    shown = dict(line.split("\t", 1) for line in text.splitlines())
    before = [sum(one["packets"] for one in report["captures"][:place]) for place in range(len(report["captures"]))]
    expected = [(one["frame"] + before[one["capture"]], f"{one['kind']}: {one['what']}") for one in report["findings"]]
    expected += [(one["frame"] + before[one["capture"]], f"is in {one['status']}")
                 for device in report["devices"] for one in device["states"]]
    wrong = [one for one in expected if one[1] not in shown.get(str(one[0]), "")]
    for frame, what in wrong:
        print(f"FAILED: frame {frame} of the copy has no comment \"{what}\"", file=sys.stderr)
    print(f"annotated copy of {len(captures)} captures: {len(expected)} comments compared, {len(wrong)} missing")
    return len(expected), len(wrong)


def main():
    if not shutil.which("tshark"):
        print("skipped: tshark is missing")
        return 77
    program = isocat()
    wrong = compared = 0
    with tempfile.TemporaryDirectory() as folder:
        captures = []
        for run in RUNS:
            capture = Path(folder) / f"{run}.pcapng"
            segment = ROOT / "docs" / "faults" / f"{run}.toml"
            subprocess.run([*program, "run", segment, "--capture", capture], stdout=subprocess.DEVNULL)
            captures.append(capture)
        compared, wrong = comments(program, captures, folder)
        shared = Path(os.environ.get("ISOCAT_SHARED", ROOT / ".." / "shared")) / "captures"
        captures += sorted(shared.glob("*.pcapng"))
        for capture in captures:
            done = subprocess.run([*program, "diagnose", capture, "--json"], capture_output=True, text=True)
            witness = Witness(capture.stem, json.loads(done.stdout), frames(capture))
            witness.all()
            print(f"{capture.stem}: {witness.compared} figures compared, {witness.wrong} differ")
            wrong += witness.wrong
            compared += witness.compared
    print(f"{len(captures)} captures, {compared} figures compared, {wrong} differ")
    return 1 if wrong or not compared else 0


if __name__ == "__main__":
    sys.exit(main())
