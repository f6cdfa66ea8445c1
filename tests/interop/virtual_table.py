#!/usr/bin/env python3
"""Programs of all kinds in virtual time, each twice: the table of docs/virtual.md.

The recipes of docs/recipes.md with pysoem and ethercrab, KickCAT as in main_devices.py at the built-in segment; a MainDevice in Go (tests/interop/go), alone and started by a
shell script; our own `run --interface`; the MainDevice of crates/isocat-c, which has the segment in its own process. With --soem a
source folder of SOEM 2 that is built in its subfolder build: docs/recipes/soem.c linked with it, shared and static, and its samples.
All come to OP, and both runs have to be the same in what the program prints and in what went over the wire. --at-once lets so many
runs of each go at the same time, which have to be as one alone.

    virtual_table.py [--isocat PATH] [--cycles N] [--at-once N] [--soem FOLDER] [--only WORD] [--no-peers]

Exit codes: 0 all well, 1 something failed, 77 could not be tried.
"""
import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from main_devices import ROOT, TARGET, TOOLS, Segment, install

INTERFACE = "vt0"
RECIPES = ROOT / "docs" / "recipes"
CAN_NOT = "can't be supervised here"
SIMPLE = 'cycle = "4ms"\n[[subdevice]]\ndevice = "simple_io16"\ncount = 3\n'
HEAD = "| program | virtual s | CPU s | ratio | cycles | frames | stops | threads | judged | SYNC0 error, worst | twice |"


class Program:
    """One row: a command, and the segment file that it meets."""

    def __init__(self, name, command, segment=None, limit=None, in_process=False):
        self.name, self.command, self.segment, self.limit = name, [str(word) for word in command], segment, limit
        self.in_process = in_process


class Run:
    def __init__(self, isocat, program):
        words = program.command
        if not program.in_process:
            limit = ["--for", program.limit] if program.limit else []
            words = [isocat, "virtual", *([program.segment] if program.segment else []), *limit, "--json", "--", *words]
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
            child = subprocess.Popen(words, stdout=out, stderr=errors)
            _, status, used = os.wait4(child.pid, 0)
            self.code, self.seconds = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
            out.seek(0), errors.seek(0)
            said, self.errors = out.read().decode(errors="replace"), errors.read().decode(errors="replace")
        lines = said.splitlines()
        if program.in_process:
            self.said, self.summary = lines, {}
        else:
            self.said, self.summary = lines[:-1], json.loads(lines[-1]) if lines else {}
        self.program = self.summary.get("program", {})

    def same(self):
        keys = ("wire_hash", "lasted_ns", "stops", "frames_sent", "how", "code")
        return self.said, self.code, [self.program.get(key) for key in keys]


class Row:
    """What two runs and more came to."""

    def __init__(self, program, runs):
        first = runs[0]
        self.can_not = any(CAN_NOT in run.errors for run in runs)
        self.bad = [] if all(run.same() == first.same() for run in runs) else ["runs differ"]
        seconds = min(run.seconds for run in runs)
        if program.in_process:
            # What it prints itself: frames, states, the time that was judged.
            found = re.search(r"(\d+) frames.*?(\d+) SubDevices in OP, judged for ([\d.]+) s: (.*)", "\n".join(first.said))
            frames, count, judged, answer = found.groups() if found else ("?", 0, 0, "?")
            lasted = float(judged)
            self.bad += [f"exit code {first.code}"] if first.code else []
            cells = ["", frames, "", "", f"{answer}, {count} in OP", ""]
        else:
            ended, sessions = first.program, first.summary.get("sessions", [])
            last = sessions[-1] if sessions else {}
            judged, lasted = last.get("judged") or {}, ended.get("lasted_ns", 0) / 1e9
            errors = [abs(device["sync0_error"]["worst_ns"]) for device in judged.get("devices", []) if device.get("sync0_error")]
            count = judged.get("in_op", 0)
            if ended.get("code") not in (0, None) or ended.get("how") not in ("exited", "limit"):
                self.bad.append(f"the program {ended.get('how')} {ended.get('code')}: {first.said[-1:]} {first.errors[-200:]}")
            if not count:
                self.bad.append("no SubDevice in OP")
            cycles = ((last.get("cycle") or {}).get("interval") or {}).get("count", "")
            worst = f"{max(errors):.0f} ns" if errors else "no SYNC0"
            cells = [cycles, ended.get("frames_sent"), ended.get("stops"), ended.get("threads"),
                     f"{last.get('answer')}, {count} in OP", worst]
        ratio = f"{lasted / seconds:.0f}" if seconds else ""
        cells = [program.name, f"{lasted:.2f}", f"{seconds:.2f}", ratio, *cells, "the same" if not self.bad else "**" + "; ".join(self.bad) + "**"]
        self.text = "| " + " | ".join(str(cell) for cell in cells) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--cycles", type=int, default=10_000)
    parser.add_argument("--at-once", type=int, default=1, help="runs at the same time, beside the first two")
    parser.add_argument("--soem", type=Path)
    parser.add_argument("--only", default="", help="programs whose names have this in them")
    parser.add_argument("--no-peers", action="store_true", help="nothing from package indexes")
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="isocat-table-"))
    try:
        programs = [program for program in all_programs(arguments, folder) if arguments.only.lower() in program.name.lower()]
        if not programs:
            return 77
        print(HEAD + "\n|" + "---|" * (HEAD.count("|") - 1), flush=True)
        bad = False
        for program in programs:
            runs = [Run(arguments.isocat, program) for _ in range(2)]
            if arguments.at_once > 1:
                with ThreadPoolExecutor(arguments.at_once) as threads:
                    runs += threads.map(lambda _: Run(arguments.isocat, program), range(arguments.at_once))
            row = Row(program, runs)
            if row.can_not:
                print(f"skipped: {runs[0].errors.strip()}")
                return 77
            print(row.text, flush=True)
            bad |= bool(row.bad)
    finally:
        shutil.rmtree(folder)
    return int(bad)


def all_programs(arguments, folder):
    isocat, cycles = arguments.isocat.resolve(), str(arguments.cycles)
    simple, recipe = folder / "simple.toml", folder / "recipe.toml"
    simple.write_text(SIMPLE)
    recipe.write_text(re.search(r"```toml\n(.*?)```", (RECIPES.parent / "recipes.md").read_text(), re.S)[1])
    programs = []
    if not arguments.no_peers:
        task = Segment(isocat, folder, "built-in", arguments.cycles).task
        peers = install(["pysoem", "kickcat"])
        if "pysoem" in peers:
            programs.append(Program("pysoem, recipe, 4 ms", [peers["pysoem"][0], RECIPES / "pysoem_dc.py", INTERFACE, cycles], recipe))
        if "kickcat" in peers:
            programs.append(Program("KickCAT, 2 ms", [*peers["kickcat"], INTERFACE, task, "whole"]))
        if build_ethercrab():
            programs.append(Program("ethercrab, std, recipe, 4 ms", [TOOLS / "debug" / "recipe-ethercrab", INTERFACE, cycles], recipe))
    programs += soem(arguments, folder, recipe, cycles)
    spans = f"{arguments.cycles * 4 // 1000 + 1}s"
    programs.append(Program("isocat run --interface, 4 ms", [isocat, "run", recipe, "--interface", INTERFACE, "--for", spans], recipe))
    if shutil.which("go"):
        binary = folder / "go-main-device"
        subprocess.run(["go", "build", "-o", binary], cwd=ROOT / "tests" / "interop" / "go", check=True,
                       env=os.environ | {"CGO_ENABLED": "0", "GOFLAGS": "-buildvcs=false"})
        programs.append(Program("Go, static", [binary, INTERFACE, cycles], simple))
        script = f"echo begins; sleep 1; {binary} {INTERFACE} {cycles} | sed s/devices/SubDevices/; echo ended"
        programs.append(Program("a shell script that starts it", ["sh", "-c", script], simple))
    else:
        print("skipped: go is missing")
    if shutil.which("cc"):
        subprocess.run([ROOT / "crates" / "isocat-c" / "install.sh", "--prefix", folder / "usr"], check=True, stdout=subprocess.DEVNULL)
        examples, usr = ROOT / "crates" / "isocat-c" / "examples", folder / "usr"
        build(folder / "port", [examples / "main_device.c", examples / "port.c"],
              [f"-I{usr}/include", f"-L{usr}/lib", "-lisocat", f"-Wl,-rpath,{usr}/lib"])
        programs.append(Program("a port in C over libisocat", [folder / "port", cycles], in_process=True))
    return programs


def build_ethercrab():
    words = ["cargo", "build", "--quiet", "--locked", "--manifest-path", RECIPES / "ethercrab" / "Cargo.toml"]
    done = subprocess.run(words, env=os.environ | {"CARGO_TARGET_DIR": str(TOOLS)}, capture_output=True, text=True)
    if done.returncode:
        print(f"skipped: ethercrab can't be built: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return done.returncode == 0


def soem(arguments, folder, recipe, cycles):
    if not arguments.soem:
        return []
    root = arguments.soem.resolve()
    includes = [f"-I{root / place}" for place in ("include", "osal", "osal/linux", "oshw/linux", "build/include")]
    source, library = RECIPES / "soem.c", root / "build" / "libsoem.a"
    for name, flags in {"recipe": [], "static": ["-static"]}.items():
        build(folder / name, [source, library], [*flags, *includes, "-lpthread", "-lrt"])
    samples = root / "build" / "samples"
    fast = folder / "fast.toml"
    fast.write_text(recipe.read_text().replace('"4ms"', '"1ms"'))
    faults = folder / "faults.toml"
    faults.write_text(fast.read_text() + '[[fault]]\nat = "20s"\nwhat = "pull axis 2 for 2s"\n'
                                         '[[fault]]\nat = "60s"\nwhat = "power-cycle io 500ms"\n')
    return [
        Program("SOEM 2, recipe, 4 ms", [folder / "recipe", INTERFACE, cycles], recipe),
        Program("SOEM 2, recipe, linked statically", [folder / "static", INTERFACE, cycles], recipe),
        Program("SOEM 2, simple_ng, 5 ms", [samples / "simple_ng" / "simple_ng", INTERFACE], recipe),
        Program("SOEM 2, ec_sample, 1 ms", [samples / "ec_sample" / "ec_sample", INTERFACE, "1000"], fast, "120s"),
        Program("the same, a cable pulled at 20 s and plugged at 22 s, a power cycle at 60 s",
                [samples / "ec_sample" / "ec_sample", INTERFACE, "1000"], faults, "120s"),
    ]


def build(target, sources, flags):
    subprocess.run(["cc", "-O2", "-o", target, *sources, *flags], check=True)


if __name__ == "__main__":
    sys.exit(main())
