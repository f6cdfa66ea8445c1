"""Memory over very many runs: what this process holds as a sweep goes.

    python benches/memory.py [RUNS]           a sweep
    python benches/memory.py [RUNS] loop      segment.run in a loop

Rows go to a folder, so that nothing need stay. Each run of the sweep has another copy time and
other cables, and so a profile of its own.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time

import isocat


def resident() -> float:
    """MB."""
    with open("/proc/self/status", encoding="ascii") as status:
        line = next(line for line in status if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1000


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    segment = isocat.Segment(cycle="1ms", for_="2ms")
    segment.add("simple_io4")
    began, told = time.monotonic(), [0]

    def tell(over: int, _bad: int, total: int) -> None:
        if over * 10 // total >= len(told):
            told.append(over)
            print(
                f"{over:>8} runs  {resident():6.1f} MB  {time.monotonic() - began:6.0f} s",
                flush=True,
            )

    if sys.argv[2:] == ["loop"]:
        for seed in range(1, runs + 1):
            segment.run(seed=seed)
            tell(seed, 0, runs)
        return
    grid = {"subdevice[*].cable": "1m..100m", "subdevice[*].copy_time": "1us..100us"}
    folder = tempfile.mkdtemp()
    try:
        result = isocat.sweep(segment, grid, seeds=runs, to=folder, progress=tell)
        print(f"{result.runs} runs, {result.good} as expected: {resident():.1f} MB")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
