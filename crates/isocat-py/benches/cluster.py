"""A sweep on Ray against the same on threads of one process: throughput, in turns, and whether the
rows are the same to the byte; in the last round a worker is killed in the middle.

    RAY_worker_niceness=0 python benches/cluster.py [ROUNDS] [RUNS]

It uses the cluster of ``ray start`` if there is one (``RAY_ADDRESS=auto``), else one of its own with
two workers. Other programs on the machine make both slower, so only the ratio of a round says
something.
"""

from __future__ import annotations

import os
import signal
import statistics
import sys
import threading
import time
from pathlib import Path

import isocat
import ray


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    runs = int(sys.argv[2]) if len(sys.argv) > 2 else 10_000
    segment = isocat.Segment(cycle="1ms", for_="20ms")
    segment.add("simple_io4")
    grid = {
        "cycle": ["500us", "1ms"],
        "host.jitter": ["5us", "20us", "50us", "100us", "200us"],
    }
    if "RAY_ADDRESS" in os.environ:
        ray.init(log_to_driver=False)
    else:
        ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    print(f"{len(ray.nodes())} nodes, {ray.cluster_resources()['CPU']:.0f} processors")
    executor = isocat.ray(batch=runs // 20)
    # Workers start, and import isocat, before the clock runs.
    isocat.sweep(segment, grid, seeds=10, executor=isocat.ray(batch=25), progress=False)
    ratios = []
    for number in range(rounds + 1):
        began = time.monotonic()
        here = isocat.sweep(segment, grid, seeds=runs // 10, progress=False)
        threads = time.monotonic() - began
        killed: list[int] = []
        if number == rounds:
            threading.Thread(target=kill_one, args=(threads / 2, killed), daemon=True).start()
        began = time.monotonic()
        there = isocat.sweep(segment, grid, seeds=runs // 10, executor=executor, progress=False)
        cluster = time.monotonic() - began
        same = here.table.parquet_bytes() == there.table.parquet_bytes()
        assert same and there.runs == runs and bool(killed) == (number == rounds)
        note = f", worker {killed[0]} killed after {threads / 2:.0f} s" if killed else ""
        print(
            f"{runs} runs: threads {runs / threads:6.0f} runs/s, Ray {runs / cluster:6.0f} runs/s, "
            f"ratio {threads / cluster:.2f}; the same rows{note}",
            flush=True,
        )
        if not killed:
            ratios.append(threads / cluster)
    print(f"ratio in the middle: {statistics.median(ratios):.2f}")


def kill_one(after: float, killed: list[int]) -> None:
    """Kills a worker that runs a batch."""
    time.sleep(after)
    while not killed:
        for entry in Path("/proc").iterdir():
            try:
                title = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if title.startswith(b"ray::isocat.sweep"):
                os.kill(int(entry.name), signal.SIGKILL)
                killed.append(int(entry.name))
                return


if __name__ == "__main__":
    main()
