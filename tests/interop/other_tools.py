#!/usr/bin/env python3
"""What `isocat plan --for TOOL` prints, in the hands of the tools: pysoem and ethercrab bring the segment up and are judged in
virtual time, kickcat brings up one without SYNC, PyYAML and ElementTree read what is for ros2 and lcec, and the numbers are those
of the plan. With SOEM=FOLDER, a build of SOEM 2 with its library in FOLDER/build, the program in C is compiled and run, too.

    other_tools.py [--isocat PATH]

Neither root nor an interface is needed. Exit codes: 0 all well, 1 something failed, 77 could not be tried.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree
from pathlib import Path

from main_devices import HERE, TARGET, TOOLS, install

SEGMENT = HERE.parent.parent / "crates" / "isocat" / "tests" / "golden" / "tools" / "segment.toml"
WITHOUT_SYNC = """cycle = "4ms"
[[subdevice]]
device = "hpmicro_ecat_cia402_ssc"
mode = "sm"
[[subdevice]]
device = "simple_io16"
"""
CYCLES = 2000
# How far a foreign host may be from its phase, ns: ethercrab wakes late by a part of each cycle.
HOST = 100_000
IN_SYNC, NOT_KNOWN = 0, 3


class Checks:
    """Runs what is printed and keeps what is wrong."""

    def __init__(self, isocat, folder):
        self.isocat, self.folder, self.wrong = isocat, folder, 0
        self.without = folder / "without.toml"
        self.without.write_text(WITHOUT_SYNC)

    def tell(self, what, bad):
        print(f"{'FAILED' if bad else 'ok'}: {what} {bad}".rstrip(), flush=True)
        self.wrong += bool(bad)

    def plan(self, segment, *keys):
        return subprocess.run([self.isocat, "plan", segment, *keys], capture_output=True, text=True, check=True).stdout

    def written(self, segment, tool, name):
        path = self.folder / name
        self.plan(segment, "--for", tool, "--out", path)
        return path

    def run(self, tool, segment, *command):
        """A program in virtual time; it comes to the plan's phase, and is in sync where there is SYNC."""
        command = [self.isocat, "virtual", segment, "--interface", "vt0", "--json", "--", *command, "vt0", str(CYCLES)]
        done = subprocess.run(command, capture_output=True, text=True)
        lines = done.stdout.splitlines()
        summary = json.loads(lines[-1]) if lines and lines[-1].startswith("{") else {}
        if summary.get("program", {}).get("code") != 0:
            return self.tell(tool, f"{done.returncode}: {lines[:-1][-3:]} {done.stderr.strip()[-300:]}")
        expected = (IN_SYNC,) if segment == SEGMENT else (IN_SYNC, NOT_KNOWN)
        judged = summary["sessions"][0]["judged"]
        bad = "" if done.returncode in expected else f"exit code {done.returncode}: {judged['devices']}"
        plan = json.loads(self.plan(segment, "--json"))
        for device, of_plan in zip(judged["devices"], plan["devices"]):
            slack = [line["slack_ns"] for line in of_plan["lines"] if line["check"] == "outputs-before-sync0"]
            margin = device["sync0_margin"]
            if device["state"] != "OP":
                bad += f" {device['name']} is in {device['state']};"
            if slack and margin and abs(margin["min_ns"] - slack[0]) > HOST:
                bad += f" {device['name']}: outputs are ready {margin['min_ns']} ns before SYNC0, by the plan {slack[0]};"
        self.tell(f"{tool}: {judged['in_op']} in OP, in sync: {judged['in_sync']}", bad)

    def python(self, tool, segment):
        if install([tool]):
            # Under the library's own name it would import itself.
            program = self.written(segment, tool, f"planned_{tool}.py")
            self.run(tool, segment, TOOLS / "venv" / "bin" / "python", program)

    def ethercrab(self):
        project = self.folder / "ethercrab"
        (project / "src").mkdir(parents=True)
        # The same dependencies as in the other tests of it, so that nothing is compiled twice.
        for name in ["Cargo.toml", "Cargo.lock"]:
            text = (HERE / "ethercrab" / name).read_text()
            (project / name).write_text(text.replace("interop-ethercrab", "planned-ethercrab"))
        build = ["cargo", "build", "--quiet", "--locked", "--manifest-path", project / "Cargo.toml"]
        for name, segment in [("DC", SEGMENT), ("no DC", self.without)]:
            self.written(segment, "ethercrab", "ethercrab/src/main.rs")
            done = subprocess.run(build, env=os.environ | {"CARGO_TARGET_DIR": str(TOOLS)}, capture_output=True, text=True)
            if done.returncode != 0:
                missing = "error[" not in done.stderr and "error: " in done.stderr
                return print(f"skipped: ethercrab can't be built: {done.stderr.strip()[-300:]}") if missing else \
                    self.tell("ethercrab", done.stderr)
            self.run(f"ethercrab, {name}", segment, TOOLS / "debug" / "planned-ethercrab")

    def soem(self, root):
        program = self.folder / "soem"
        folders = [root / "include", root / "osal", root / "osal/linux", root / "oshw/linux", root / "build/include"]
        for segment in [SEGMENT, self.without]:
            source = self.written(segment, "soem", "soem.c")
            cc = ["cc", "-O1", "-Wall", "-Wextra", "-o", program, source, *(f"-I{folder}" for folder in folders),
                  f"-L{root / 'build'}", "-lsoem", "-lpthread", "-lrt"]
            done = subprocess.run(cc, capture_output=True, text=True)
            if done.returncode != 0:
                return self.tell("SOEM", done.stderr)
            self.run("SOEM", segment, program)

    def lcec(self):
        slaves = xml.etree.ElementTree.fromstring(self.plan(SEGMENT, "--for", "lcec")).findall("master/slave")
        found = [dict(slave.find("dcConf").attrib) if slave.find("dcConf") is not None else None for slave in slaves]
        wanted = []
        for device in json.loads(self.plan(SEGMENT, "--json"))["devices"]:
            values = {"sync0Cycle": "sync0_cycle_ns", "sync0Shift": "sync0_phase_ns", "sync1Cycle": "sync1_ns"}
            wanted.append({name: str(device[key]) for name, key in values.items() if device[key] is not None} or None)
        for dc in filter(None, found):
            dc.pop("assignActivate"), dc.pop("sync1Shift", None)
        self.tell(f"lcec: {len(found)} slaves by ElementTree", "" if found == wanted else f"{found}, expected {wanted}")

    def ros2(self):
        python = TOOLS / "venv" / "bin" / "python"
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "pyyaml==6.0.3"]
        if not python.exists() or subprocess.run(pip, capture_output=True).returncode != 0:
            return print("skipped: PyYAML can't be installed")
        code = "import json, sys, yaml; print(json.dumps(list(yaml.safe_load_all(sys.stdin))))"
        read = subprocess.run([python, "-c", code], input=self.plan(SEGMENT, "--for", "ros2"), capture_output=True, text=True)
        if read.returncode != 0:
            return self.tell("ros2", read.stderr)
        files, bad = json.loads(read.stdout), ""
        devices = json.loads(self.plan(SEGMENT, "--start-up", "--json"))["devices"]
        devices = [device for device in devices if device["outputs"] or device["inputs"]]
        for file, device in zip(files, devices, strict=True):
            bits = lambda pdos: sum(int(channel["type"].strip("uintb")) for pdo in pdos for channel in pdo["channels"])
            identity = (file["vendor_id"], file["product_id"]) == tuple(int(device[name], 16) for name in ("vendor", "product"))
            lengths = [bits(file["rpdo"]), bits(file["tpdo"])] == [device[name]["length"] for name in ("outputs", "inputs")]
            values = {(sdo["index"], sdo["sub_index"]): sdo["value"] for sdo in file.get("sdo", [])}
            objects = {tuple(int(part, 16) for part in step["object"].split(":")):
                       int.from_bytes(bytes.fromhex(step["data"]), "little") for step in device["objects"]}
            objects = {entry: value for entry, value in objects.items() if entry[0] not in (0x1C12, 0x1C13)}
            if not (identity and lengths and values == objects):
                bad += f" {device['name']}: {file}"
        self.tell(f"ros2: {len(files)} files by PyYAML", bad)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    isocat = parser.parse_args().isocat
    if not isocat.exists():
        print(f"skipped: {isocat} is missing")
        return 77
    with tempfile.TemporaryDirectory(prefix="isocat-tools-") as folder:
        checks = Checks(isocat.resolve(), Path(folder))
        checks.python("pysoem", SEGMENT)
        checks.python("pysoem", checks.without)
        checks.python("kickcat", checks.without)
        checks.ethercrab()
        if "SOEM" in os.environ:
            checks.soem(Path(os.environ["SOEM"]).resolve())
        checks.lcec()
        checks.ros2()
        return int(bool(checks.wrong))


if __name__ == "__main__":
    sys.exit(main())
