"""What Python costs: the same runs by a program in Rust, and from Python, in turns.

    cargo build --release -p isocat-engine --example many_runs
    python benches/overhead.py target/release/examples/many_runs [ROUNDS] [RUNS]

Processor time is compared, as other programs do not count in it. The start of each process is
measured by one run and taken off. Each round gives a ratio to the Rust of the same round, so that a
processor that gets slower, or faster, is so for all of them.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import isocat

SWEEP = """
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
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program = sys.argv[1]
    rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 15
    runs = int(sys.argv[3]) if len(sys.argv) > 3 else 200
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "segment.toml")
        isocat.Segment(isocat.Segment.built_in(), for_="100ms").save(path)
        pairs = {
            "a run in a loop": ([program, path, "loop"], [sys.executable, "-c", LOOP, path]),
            "a run of a sweep": ([program, path, "sweep"], [sys.executable, "-c", SWEEP, path]),
        }
        print(f"{runs} runs of 100 ms, {rounds} rounds; processor time of a run")
        for name, commands in pairs.items():
            times: list[list[float]] = []
            for number in range(rounds):
                # Every second round goes the other way, so that none is always the first.
                order = (0, 1) if number % 2 else (1, 0)
                spent = {
                    way: cpu([*commands[way], str(runs + 1)]) - cpu([*commands[way], "1"])
                    for way in order
                }
                times.append([spent[0], spent[1]])
            rust, python = (1000 * min(column) / runs for column in zip(*times))
            ratios = [python / rust for rust, python in times]
            print(
                f"{name:<18} Rust {rust:.2f} ms at least, Python {python:.2f} ms at least; "
                f"ratio {statistics.median(ratios):.3f} in the middle "
                f"({min(ratios):.3f} to {max(ratios):.3f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
