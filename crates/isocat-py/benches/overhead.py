"""What Python costs: the same runs by `isocat.sweep` and by the command's own sweep in Rust, on one
thread, in turns.

    python benches/overhead.py [ROUNDS] [RUNS]

Both are of the same module, so the code that runs is the same. Processor time is compared, as other
programs do not count in it; the start of each process is measured by a sweep of one run and taken
off.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import isocat

PYTHON = """
import sys, isocat
isocat.sweep(sys.argv[1], seeds=int(sys.argv[2]), workers=1, progress=False).table
"""
LOOP = """
import sys, isocat
segment = isocat.Segment(sys.argv[1])
for seed in range(1, int(sys.argv[2]) + 1):
    segment.run(seed=seed).in_sync
"""


def cpu(command: list[str]) -> float:
    """Processor seconds of a process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False, text=True
    )
    assert done.returncode in (0, 1), done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    runs = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "segment.toml")
        isocat.Segment(isocat.Segment.built_in(), for_="100ms").save(path)
        ways = {
            "the command's sweep (Rust)": lambda n: [
                sys.executable,
                "-m",
                "isocat",
                "sweep",
                path,
                "--jobs",
                "1",
                "--seeds",
                str(n),
            ],
            "isocat.sweep": lambda n: [sys.executable, "-c", PYTHON, path, str(n)],
            "segment.run in a loop": lambda n: [sys.executable, "-c", LOOP, path, str(n)],
        }
        times = {name: 0.0 for name in ways}
        for _ in range(rounds):
            for name, command in ways.items():
                times[name] += cpu(command(runs + 1)) - cpu(command(1))
    rust = next(iter(times.values()))
    for name, seconds in times.items():
        each = 1000 * seconds / rounds / runs
        print(f"{name:<28} {each:7.3f} ms of processor time for a run, ratio {seconds / rust:.3f}")


if __name__ == "__main__":
    main()
