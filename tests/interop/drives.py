#!/usr/bin/env python3
"""Drives behind SoE in the hands of a foreign MainDevice, and in the eyes of a foreign dissector, in virtual time.

pysoem (SOEM) finds the process data of two drives by S-0-0016, S-0-0024 and the attributes of what they list, which is how SOEM maps
SoE drives, and asks for a file, which must end with an error and not with a time-out. Where tshark is there, it dissects
what pysoem and the MainDevice of isocat sent and got.

    drives.py [--isocat PATH]

Exit codes: 0 all well, 1 something failed, 77 could not be tried.
"""
import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from main_devices import TARGET, install

DESCRIPTION = Path(__file__).resolve().parents[2] / "crates/isocat/tests/esi/drives.xml"
PROGRAM = '''
import json, sys, time
import pysoem
pysoem.settings.timeouts.ret = 100_000
main_device = pysoem.Master()
main_device.open(sys.argv[1])
main_device.manual_state_change = True
main_device.config_init()
drives = main_device.slaves[0]
main_device.state = pysoem.PREOP_STATE
main_device.write_state()
main_device.state_check(pysoem.PREOP_STATE, 5_000_000)
seen = {}
for name, ask in [("read", lambda: drives.foe_read("firmware", 0, 1000, 2_000_000)),
                  ("write", lambda: drives.foe_write("firmware", 0, b"abc", 2_000_000))]:
    begun = time.monotonic()
    try:
        answer = ask()
    except Exception as error:
        answer = error
    seen[name] = [repr(answer), time.monotonic() - begun]
try:
    main_device.config_map()
except pysoem.ConfigMapError as error:
    # SOEM asks drives 0 to 7; pysoem takes each answer that there is none for an error of its own.
    seen["absent"] = len(error.args[0])
seen["bytes"] = [len(drives.output), len(drives.input)]
print(json.dumps(seen))
'''
failed = False


def expect(what, found, wanted):
    global failed
    failed |= found != wanted
    print(f"{'ok' if found == wanted else 'FAILED'}: {what}: {found}" + ("" if found == wanted else f", expected {wanted}"))


def messages(capture):
    """What tshark says of each message in a mailbox, with those that come back once."""
    fields = ["-T", "fields", "-e", "_ws.col.Info"]
    shown = subprocess.run(["tshark", "-r", capture, "-Y", "ecat.cnt > 0", *fields], capture_output=True, text=True, check=True)
    return [line.split("Mbx", 1)[1] for line in shown.stdout.splitlines() if "Mbx" in line]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    arguments = parser.parse_args()
    peers = install(["pysoem"])
    if not peers:
        return 77
    python = peers["pysoem"][0]
    folder = Path(tempfile.mkdtemp(prefix="isocat-drives-"))
    try:
        segment, program = folder / "drives.toml", folder / "drives.py"
        segment.write_text(f'cycle = "1ms"\n[[subdevice]]\nesi = "{DESCRIPTION}"\n')
        program.write_text(PROGRAM)
        captures = [folder / "pysoem.pcapng", folder / "isocat.pcapng"]
        command = [arguments.isocat, "virtual", segment, "--interface", "vt0", "--capture", captures[0], "--", python, program, "vt0"]
        done = subprocess.run(command, capture_output=True, text=True)
        if "can't be supervised here" in done.stderr:
            print(f"skipped: {done.stderr.strip()}")
            return 77
        lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
        if not lines:
            print(f"FAILED: the program said nothing: {done.stdout[-500:]} {done.stderr[-500:]}")
            return 1
        seen = json.loads(lines[0])
        # Words of 2 bytes and what S-0-0024 and S-0-0016 list: 2 + 4 and 2 + 4, 2 + 4 and 2 + 2.
        expect("bytes of outputs and inputs, as SOEM finds them by SoE", seen["bytes"], [12, 10])
        expect("lists of drives that are not there", seen.get("absent"), 12)
        for name in ["read", "write"]:
            expect(f"a file's {name} ends within 100 ms: {seen[name]}", seen[name][1] < 0.1, True)
        run = [arguments.isocat, "run", segment, "--for", "20ms", "--capture", captures[1]]
        expect("isocat's own MainDevice, exit code", subprocess.run(run, capture_output=True).returncode, 0)
        if not shutil.which("tshark"):
            print("skipped: tshark is not there")
            return int(failed)
        by_pysoem, by_isocat = (messages(capture) for capture in captures)
        for text, wanted in [("FoE ERR (32769) : 'no files'", 1), ("FoE ERR (32770) : 'no files'", 1), ("SoE: Error 800a", 12),
                             ("SoE: RRS (S-0-0024, 'V')", 2), ("SoE: RRS (S-0-0047, 'A')", 1)]:
            expect(f"tshark, of pysoem: {text}", sum(text in message for message in by_pysoem), wanted)
        for text, wanted in [("SoE: WRS (S-0-0001, 'V')", 1), ("SoE: WRS (S-0-0032, 'V')", 1), ("SoE: WRS (P-0-0010, 'V')", 1), ("SoE: WRS (P-0-0232, 'V')", 1)]:
            expect(f"tshark, of isocat: {text}", sum(text in message for message in by_isocat), wanted)
        for name, capture in zip(["pysoem", "isocat"], captures):
            bad = subprocess.run(["tshark", "-r", capture, "-Y", "_ws.malformed || _ws.expert.severity >= 8388608"], capture_output=True, text=True)
            expect(f"malformed frames of {name}", len(bad.stdout.splitlines()), 0)
        return int(failed)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
