#!/usr/bin/env python3
"""A start-up list of `isocat plan --start-up --json`, carried out by a foreign MainDevice: ethercrab sends exactly its writes,
and nothing else, to a segment that `isocat serve --setup-veth` puts behind a veth pair in a namespace of its own. All
SubDevices have to come to OP and to hold it.

Needs root, `ip` and a package index. Exit codes: 0 all well, 1 something failed, 77 could not be tried.
"""
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", HERE.parent.parent / "target")).resolve()
TOOLS = TARGET / "interop"
SEGMENT = """cycle = "4ms"
[[subdevice]]
device = "model_every_mode"
mode = "sm"
[[subdevice]]
device = "simple_io16"
[[subdevice]]
device = "hpmicro_ecat_cia402_ssc"
mode = "sm"
"""


def main():
    for what, missing in [("root", os.geteuid() != 0), ("ip", not shutil.which("ip"))]:
        if missing:
            print(f"skipped: {what} is missing")
            return 77
    manifest = HERE / "ethercrab" / "Cargo.toml"
    build = ["cargo", "build", "--quiet", "--locked", "--bin", "start_up", "--manifest-path", manifest]
    done = subprocess.run(build, env=os.environ | {"CARGO_TARGET_DIR": str(TOOLS)}, capture_output=True, text=True)
    if done.returncode != 0:
        print(f"skipped: ethercrab can't be built: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
        return 77
    isocat = TARGET / "release" / "isocat"
    namespace = f"isosu{os.getpid() % 100_000}"
    with tempfile.TemporaryDirectory() as folder:
        segment, written = Path(folder) / "segment.toml", Path(folder) / "list.json"
        segment.write_text(SEGMENT)
        plan = subprocess.run([isocat, "plan", segment, "--start-up", "--json"], capture_output=True, text=True)
        if plan.returncode != 0:
            print(f"the plan fails: {plan.stderr}")
            return 1
        written.write_text(plan.stdout)
        server = subprocess.Popen([isocat, "serve", segment, "--setup-veth", namespace, "--json"], stdout=subprocess.PIPE, text=True)
        try:
            greeting = json.loads(server.stdout.readline())
            assert greeting["event"] == "serving", greeting
            copier = subprocess.Popen(["cat"], stdin=server.stdout, stdout=subprocess.DEVNULL)
            command = ["ip", "netns", "exec", namespace, TOOLS / "debug" / "start_up", namespace, written, "500"]
            code = subprocess.run(command, timeout=60).returncode
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait(20)
        copier.wait(20)
    print("a foreign MainDevice carried the start-up list out" if code == 0 else "the start-up list does not lead to OP")
    return 0 if code == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
