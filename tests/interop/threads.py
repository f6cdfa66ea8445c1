#!/usr/bin/env python3
"""What people reported in public, each with an input of our own: does isocat give the answer that the thread ended with?

Each file of tests/threads is one thread:

    report, origin, ended, kind     what was reported, where, how it ended, and of which kind it is
    open                            what isocat says today and what would be right, of a case that it does not answer yet
    [files]                         inputs, by name: segment files, descriptions (ESI), EEPROMs as Intel HEX
    [[ask]]                         commands, in their order, in a folder with these files
      do                            arguments of isocat. MISTAKE stands for Python with mistakes_pysoem.py, PYTHON for Python alone
      exit                          the exit code, or a list of those that are right
      verdict                       what the first sentence says
      symptom, cause, remedy        what the answer says
      never                         what it must not say: blame of what is well

All but `do` and `exit` are lists of regular expressions, tried on text whose line breaks are spaces, without regard to case, and without
the list of faults that the file itself asked for. Four things are computed of each case:

    expressed    no command refuses its input (exit code 2, unless that is the right one); else the case has nothing
    symptom      exit codes are right, and `symptom` is there
    cause        `verdict` and `cause` are there
    remedy       `remedy` is there

A case with all four and nothing forbidden is *whole*. An answer is *wrong* if its exit code is not the right one or it says what it must not.

    threads.py [--isocat PATH] [--only NAME]... [--show]

Exit codes: 0 all as marked, 1 a case that is not `open` is not whole, or one that is `open` has become whole, 77 could not be tried.
Cases that need a foreign program are left out where pysoem can't be installed.
"""
import argparse
import collections
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from main_devices import ROOT, TARGET, install

try:
    import tomllib
except ImportError:
    print("skipped: Python 3.11 is missing")
    sys.exit(77)

THREADS = ROOT / "tests" / "threads"
PROGRAM = Path(__file__).resolve().parent / "mistakes_pysoem.py"
KINDS = ["timing", "answers", "clocks", "rhythm", "numbers", "descriptions", "dead-line", "devices", "asked-not-done", "words"]
TEXTS = ["verdict", "symptom", "cause", "remedy", "never"]
PARTS = ["expressed", "symptom", "cause", "remedy"]
# Where the verdict of `virtual` begins: what stands before it is how long it ran.
VERDICT = re.compile(r"^ ?(In sync|Not |No |no |Nothing|Not known)", re.MULTILINE)
# What the file itself asked for is no answer.
ECHO = re.compile(r"^ ?What went wrong, as the segment file asks.*?(\n\s*\n|\Z)", re.MULTILINE | re.DOTALL)
TIMEOUT = 120


class Case:
    def __init__(self, path):
        self.name = path.stem
        try:
            case = tomllib.loads(path.read_text())
        except tomllib.TOMLDecodeError as error:
            raise SystemExit(f"{path}: {error}") from error
        self.kind, self.open, self.asks = case["kind"], case.get("open"), case["ask"]
        self.files = case.get("files", {})
        unknown = case.keys() - {"report", "origin", "ended", "kind", "open", "files", "ask"}
        unknown |= {key for ask in self.asks for key in ask.keys() - {"do", "exit", *TEXTS}}
        missing = {"report", "origin", "ended"} - case.keys()
        if unknown or missing or self.kind not in KINDS:
            raise SystemExit(f"{path}: unknown {sorted(unknown)}, missing {sorted(missing)}, kind {self.kind}")
        self.foreign = any("MISTAKE" in ask["do"] or "PYTHON" in ask["do"] for ask in self.asks)

    def run(self, isocat, python):
        self.has, self.wrong, self.lacks, self.said = dict.fromkeys(PARTS, True), [], [], []
        with tempfile.TemporaryDirectory(prefix="isocat-threads-") as folder:
            for name, text in self.files.items():
                Path(folder, name).write_text(text)
            for ask in self.asks:
                self.ask(ask, self.arguments(ask["do"], isocat, python), folder)
        self.whole = all(self.has.values()) and not self.wrong
        return self

    @staticmethod
    def arguments(line, isocat, python):
        words = {"MISTAKE": [python, PROGRAM], "PYTHON": [python], "ISOCAT": [isocat]}
        return [isocat, *(part for word in shlex.split(line) for part in words.get(word, [word]))]

    def ask(self, ask, command, folder):
        try:
            done = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=TIMEOUT)
            code, text = done.returncode, done.stdout + done.stderr
        except subprocess.TimeoutExpired:
            code, text = None, f"no end within {TIMEOUT} s"
        self.said.append((ask["do"], code, text))
        text = ECHO.sub("", text)
        start = VERDICT.search(text) if ask["do"].startswith("virtual") else None
        flat = " ".join(text.split())
        first = " ".join(text[start.start() if start else 0:].split())[:400]
        right = ask["exit"] if isinstance(ask["exit"], list) else [ask["exit"]]
        if code not in right:
            self.wrong.append(f"exit {code} of `{ask['do']}`")
            self.has["symptom"] = False
            if code in (2, None):
                self.has = dict.fromkeys(PARTS, False)
                return
        for part, where in [("verdict", first), ("symptom", flat), ("cause", flat), ("remedy", flat)]:
            for pattern in ask.get(part, []):
                if not re.search(pattern, where, re.IGNORECASE):
                    self.lacks.append(f"{part} /{pattern}/ of `{ask['do']}`")
                    self.has["cause" if part == "verdict" else part] = False
        for pattern in ask.get("never", []):
            if re.search(pattern, flat, re.IGNORECASE):
                self.wrong.append(f"/{pattern}/ said by `{ask['do']}`")

    def outcome(self):
        """What is wrong with the mark of the file, or nothing."""
        if self.open and self.whole:
            return "whole, and marked as open"
        if not self.open and not self.whole:
            return "not whole"
        return ""

    def line(self):
        parts = " ".join(part if self.has[part] else "-" * len(part) for part in PARTS)
        state = "whole" if self.whole else "WRONG" if self.wrong else "in part" if any(self.has.values()) else "none"
        rest = "; ".join(self.wrong + self.lacks)
        return f"{self.name:34} {parts} {state}{' (open)' if self.open else ''}{': ' + rest if rest else ''}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--isocat", type=Path, default=TARGET / "release" / "isocat")
    parser.add_argument("--only", action="append", default=[], metavar="NAME")
    parser.add_argument("--show", action="store_true", help="print what isocat said")
    arguments = parser.parse_args()
    if not arguments.isocat.exists():
        print(f"skipped: {arguments.isocat} is missing")
        return 77
    cases = [Case(path) for path in sorted(THREADS.glob("*.toml")) if not arguments.only or path.stem in arguments.only]
    peers = install(["pysoem"]) if any(case.foreign for case in cases) else {}
    python = peers["pysoem"][0] if peers else None
    table, failed, tried = collections.defaultdict(collections.Counter), [], 0
    for case in cases:
        if case.foreign and not python:
            print(f"{case.name:34} left out: pysoem is missing")
            continue
        tried += 1
        case.run(arguments.isocat.resolve(), python)
        print(case.line(), flush=True)
        if arguments.show:
            for do, code, text in case.said:
                print(f"--- {do}: {code}\n{text}")
        table[case.kind].update(["threads", *(part for part in PARTS if case.has[part])])
        table[case.kind].update(["whole"] * case.whole + ["wrong"] * bool(case.wrong) + ["open"] * bool(case.open))
        if case.outcome():
            failed.append(f"{case.name}: {case.outcome()}")
    if not tried:
        return 77
    columns = ["threads", *PARTS, "whole", "open", "wrong"]
    print(f"\n| kind | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}")
    total = sum(table.values(), collections.Counter())
    for kind, counts in [*((kind, table[kind]) for kind in KINDS if kind in table), ("all", total)]:
        print(f"| {kind} | {' | '.join(str(counts[column]) for column in columns)} |")
    for line in failed:
        print(line)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
